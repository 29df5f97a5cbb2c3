"""The operator's own keys: ``keys.toml`` beside the user's rig.toml, with lines like ``"scan.start" = "S"``."""

from __future__ import annotations

import difflib
import os
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path

from acquire.contract.errors import ConfigError

RESERVED = frozenset({"space", "1", "2", "3", "4", "5", "6", "question_mark", "?", "ctrl+p", ":", "colon"})
"""Keys that mean the same everywhere, STOP before all."""


def keymap_path(environ: Mapping[str, str] = os.environ) -> Path:
    """Where the operator's keys are looked for."""
    home = environ.get("XDG_CONFIG_HOME") or str(Path("~/.config").expanduser())
    return Path(home) / "sweepscope" / "keys.toml"


def load_keymap(path: Path, known: Collection[str]) -> dict[str, str]:
    """Action -> keys (several with commas); empty when there is no such file.

    Raises:
        ConfigError: unreadable, an action that is not ``known`` (with the nearest one), or a key that is not free.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"cannot read the keys in {path}: {error}") from None
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
