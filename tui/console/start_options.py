"""What a console is started with: from the command line, the configuration, the operator's own keys, the terminal."""

from __future__ import annotations

import os
from collections.abc import Mapping

from textual.binding import Binding

from acquire.contract.config.load import LoadedConfig
from tui.client.client_name import my_name, user_name
from tui.console.app import ConsoleApp
from tui.console.keys.keymap import keymap_path, load_keymap
from tui.console.options import ConsoleOptions
from tui.console.screen_table import SCREENS
from tui.console.state.scan_draft import Draft


def options_for(
    config: LoadedConfig,
    *,
    ascii_only: bool = False,
    read_only: bool = False,
    owns_rig: bool = False,
    mouse: bool = False,
    picture: str = "half",
    theme: str = "sweepscope-dark",
    environ: Mapping[str, str] = os.environ,
) -> ConsoleOptions:
    """Raises ConfigError where the operator's keys cannot be used."""
    keymap = load_keymap(keymap_path(environ), known_actions())
    return ConsoleOptions(
        ascii_only=ascii_only,
        read_only=read_only,
        owns_rig=owns_rig,
        me=my_name(),
        draft=Draft.of_config(config.rig, operator=user_name()),
        keymap=keymap,
        mouse=mouse,
        picture=picture,
        theme=theme,
        data_dir=config.data_dir,
    )


def known_actions() -> set[str]:
    """Every action that may be given another key."""
    found = {binding.id for binding in ConsoleApp.BINDINGS if isinstance(binding, Binding) and binding.id}
    for entry in SCREENS:
        screen = entry.make(ascii_only=True)
        found |= {binding.id for _, binding in screen._bindings if binding.id}
    return found
