"""Runs the console on this terminal, with its connection to the rig and the operator's own keys."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from textual.binding import Binding
from textual.dom import DOMNode

from tui.console.app import ConsoleApp
from tui.console.keys import keymap_path, load_keymap
from tui.console.link.messages import Updates
from tui.console.link.rig_link import RigLink
from tui.console.options import ConsoleOptions
from tui.console.screen_table import SCREENS
from tui.console.screens.registry import screen_class
from tui.console.shell import RigConnection
from tui.console.terminal.terminal import prepare_terminal
from tui.console.terminal.terminal_driver import ConsoleDriver


def known_actions() -> set[str]:
    """The ids of all bindings: the actions that may be given another key."""
    classes: list[type[DOMNode]] = [ConsoleApp, *(screen_class(entry.name) for entry in SCREENS)]
    found = (binding for screen in classes for binding in Binding.make_bindings(screen.BINDINGS))
    return {binding.id for binding in found if binding.id}


def run_console(
    options: ConsoleOptions,
    *,
    run_dir: Path | None = None,
    command_timeout_s: float = 5.0,
    on_started: Callable[[Callable[[str, str], None]], None] | None = None,
) -> int:
    """Run the console on this terminal until the operator leaves; returns the exit status.

    ``on_started`` gets a function that logs a text with its level, from any thread.

    Raises:
        ConfigError: the operator's ``keys.toml`` cannot be used.
    """
    options = replace(options, keymap=load_keymap(keymap_path(), known_actions))

    def connect(post: Callable[[Updates], Any]) -> RigConnection:
        return RigLink(post, run_dir=run_dir, command_timeout_s=command_timeout_s, client=options.me)

    prepare_terminal()
    app = ConsoleApp(connect, options, on_started=on_started, driver_class=ConsoleDriver)
    if run_dir is not None:
        app.jobs.environ["SWEEPSCOPE_RUN"] = str(run_dir)
    app.run(mouse=options.mouse)
    if app.return_code:
        print("the console ended by an error; if the terminal looks odd, type: reset", file=sys.stderr)
    return app.return_code or 0
