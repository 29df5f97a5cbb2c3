"""The keys that mean the same on every screen, and the operator's own keys.

Those stand in ``keys.toml`` beside the user's rig.toml, in lines like ``"scan.start" = "S"``.
"""

from __future__ import annotations

import difflib
import os
import tomllib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from textual.binding import Binding

from acquire.contract.config.load import user_config_folder
from acquire.contract.errors import ConfigError
from acquire.contract.files import read_text, reason
from tui.console.screen_table import SCREENS

STOP_KEY = "space"
TYPING_STOP_KEY = "ctrl+x"
"""STOP everywhere, also in a dialog with fields for text, where the space bar types a space."""
RESERVED = frozenset({STOP_KEY, TYPING_STOP_KEY, "question_mark", "?", "ctrl+p", ":", "colon"}) | {
    str(number) for number in range(1, len(SCREENS) + 1)
}
"""Keys that mean the same everywhere."""

APP_BINDINGS = [
    *[
        Binding(str(number), f"go('{entry.name}')", entry.name, show=False, tooltip=entry.summary)
        for number, entry in enumerate(SCREENS, 1)
    ],
    Binding("a", "acknowledge", "acknowledge", id="acknowledge", tooltip="take the newest fault off the banner"),
    Binding("T", "control", "control", id="control", tooltip="take control of the rig, or release it"),
    Binding("colon", "palette", "actions", id="palette", tooltip="all actions of all screens (also ctrl+p)"),
    Binding("ctrl+p", "palette", "actions", show=False),
    Binding(STOP_KEY, "space_typed_ahead", "STOP", show=False),
    Binding("ctrl+t", "theme", "colours", id="theme", tooltip="next colours: dark, light, high contrast"),
    Binding("q", "quit", "quit", id="quit", tooltip="leave; a sweep goes on without this screen"),
    Binding("question_mark", "help", "help", show=False, id="help"),
]
"""The actions that every screen has."""
QUIT_ENDS_RIG = "leave, which ends the rig; during a sweep it asks first"
"""What leaving does in a console that owns the rig."""


def keymap_path(environ: Mapping[str, str] = os.environ) -> Path:
    """Where the operator's keys are read from."""
    return user_config_folder(environ) / "keys.toml"


def load_keymap(path: Path, known_actions: Callable[[], Collection[str]]) -> dict[str, str]:
    """Binding id -> keys (several with commas), as ``App.set_keymap`` takes it; empty without a file.

    ``known_actions``: asked for all binding ids once there is a file.

    Raises:
        ConfigError: unreadable, an id that is not known (with the nearest one), or a reserved key.
    """
    try:
        values = tomllib.loads(read_text(path))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"cannot read the keys in {path}: {reason(error)}") from None
    known = known_actions()
    for action, keys in values.items():
        if action not in known:
            near = difflib.get_close_matches(action, known, n=1, cutoff=0.0)
            raise ConfigError(f"{path}: there is no action {action!r}; did you mean {near[0] if near else '?'!r}?")
        if not isinstance(keys, str) or not keys:
            raise ConfigError(f"{path}: {action} needs a key as text, for example {action!r} = 'S'")
        taken = RESERVED.intersection(key.strip() for key in keys.split(","))
        if taken:
            raise ConfigError(f"{path}: {action} cannot have the key {sorted(taken)[0]!r}: it is the same everywhere")
    return values
