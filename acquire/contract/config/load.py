"""Finds, layers and checks the configuration: default < file < environment < flag; says where each value came from."""

from __future__ import annotations

import ast
import contextlib
import difflib
import functools
import inspect
import os
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from acquire.contract.errors import ConfigError
from acquire.contract.files import read_text, reason

from .allowed import allowed_words
from .model import RigConfig

ENV_PREFIX = "SWEEPSCOPE_"
ENV_SEPARATOR = "__"


@dataclass(frozen=True)
class LoadedConfig:
    """The effective configuration and where each of its values came from."""

    rig: RigConfig
    path: Path | None
    """The rig.toml that was read; None when there is none."""
    origins: dict[str, str]
    """``section.key`` -> ``default``, the file's path, the variable's name, or ``flag``."""

    @property
    def data_dir(self) -> Path:
        """The folder of all scans, with ``~`` resolved.

        Raises:
            ConfigError: its home folder is not known, or its name is not UTF-8, which files and messages cannot hold.
        """
        return home_resolved(self.rig.storage.data_dir, "storage.data_dir")

    def toml(self) -> str:
        """The effective configuration as TOML, every key written out."""
        return tomli_w.dumps(msgspec.to_builtins(self.rig))

    def explained(self) -> str:
        """TOML with each key's manual and allowed values above it, and the origin of its value beside it."""
        blocks = []
        for section, values in msgspec.to_builtins(self.rig).items():
            lines = [f"[{section}]"]
            manual = key_docs(type(getattr(self.rig, section)))
            for key, value in values.items():
                lines += [f"# {line}" for line in textwrap.wrap(manual.get(key, ""), 110)]
                lines.append(f"# Allowed: {allowed_words()[f'{section}.{key}']}.")
                line = tomli_w.dumps({key: value}).strip()
                lines.append(f"{line}  # {self.origins[f'{section}.{key}']}" if "\n" not in line else line)
            blocks.append("\n".join(lines))
        return "\n\n".join(blocks) + "\n"


def find_config_file(flag: str | None, environ: Mapping[str, str] = os.environ) -> Path | None:
    """The rig.toml that counts: the flag, ``$SWEEPSCOPE_CONFIG``, ``./``, the user's, the system's; None: no file.

    Raises:
        ConfigError: the flag or the variable names a file that is not there.
    """
    for name, named in (("--config", flag), ("SWEEPSCOPE_CONFIG", environ.get("SWEEPSCOPE_CONFIG"))):
        if named:
            if not Path(named).is_file():
                raise ConfigError(f"{name} names {named}, which is not there")
            return Path(named)
    candidates = [Path("rig.toml"), Path("/etc/sweepscope/rig.toml")]
    with contextlib.suppress(ConfigError):  # a service may have no home
        candidates.insert(1, user_config_folder(environ) / "rig.toml")
    return next((path for path in candidates if path.is_file()), None)


def user_config_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """The folder of this user's rig.toml, keys.toml and keys.

    Raises:
        ConfigError: no home folder is known.
    """
    return home_resolved(environ.get("XDG_CONFIG_HOME") or "~/.config", "XDG_CONFIG_HOME") / "sweepscope"


def home_resolved(folder: str, name: str) -> Path:
    """``folder`` with ``~`` resolved; ``name`` is what sets it.

    Raises:
        ConfigError: its home folder is not known, or its name is not UTF-8.
    """
    try:
        found = Path(folder).expanduser()
        str(found).encode()
    except RuntimeError:
        raise ConfigError(f"the home folder in {folder} is not known: set HOME, or {name} to a full path") from None
    except UnicodeEncodeError:
        raise ConfigError(f"the folder '{folder}' holds a byte that is not UTF-8: set {name} to another") from None
    return found


def load_config(
    flag: str | None = None, overrides: Mapping[str, Any] | None = None, environ: Mapping[str, str] = os.environ
) -> LoadedConfig:
    """The effective configuration.

    Args:
        flag: path given by ``--config``.
        overrides: ``section.key`` -> value, from flags.
        environ: ``SWEEPSCOPE_<SECTION>__<KEY>`` sets a key.

    Raises:
        ConfigError: unreadable, an unknown key (with the nearest valid name), or a value out of bounds.
    """
    path = find_config_file(flag, environ)
    values: dict[str, Any] = {}
    origins = dict.fromkeys(_known_keys(), "default")
    if path is not None:
        _merge(values, origins, _read_toml(path), str(path))
    for name, text in _environment(environ):
        _merge(values, origins, _nested(*_key_of_variable(name), _parse(text)), name)
    for dotted, value in (overrides or {}).items():
        section, _, key = dotted.partition(".")
        _merge(values, origins, _nested(section, key, value), "flag")
    try:
        rig = msgspec.convert(values, RigConfig, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(_explain(error, origins)) from None
    _check_together(rig)
    return LoadedConfig(rig, path, origins)


def _check_together(rig: RigConfig) -> None:
    if rig.stage.travel_max_steps <= rig.stage.travel_min_steps:
        raise ConfigError("stage.travel_max_steps must be greater than stage.travel_min_steps")
    if rig.reconstruct.median and rig.reconstruct.median % 2 == 0:
        raise ConfigError(f"reconstruct.median must be odd, or 0 for none; it is {rig.reconstruct.median}")


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read {path}: {reason(error)}") from None
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from None


@functools.cache
def _known_keys() -> tuple[str, ...]:
    return tuple(f"{section}.{key}" for section, keys in msgspec.to_builtins(RigConfig()).items() for key in keys)


@functools.cache
def _nearly_keys() -> dict[str, str]:
    """Variables that lack an underscore, with the ones that set a key."""
    names = [key.upper().partition(".") for key in _known_keys()]
    return {f"{ENV_PREFIX}{part}_{key}": f"{ENV_PREFIX}{part}{ENV_SEPARATOR}{key}" for part, _, key in names}


def _merge(values: dict[str, Any], origins: dict[str, str], layer: Mapping[str, Any], origin: str) -> None:
    sections = {name.partition(".")[0] for name in _known_keys()}
    for section, keys in layer.items():
        if section not in sections:
            raise ConfigError(f"{origin}: unknown section [{section}]{_nearest(section, sections)}")
        if not isinstance(keys, Mapping):
            raise ConfigError(f"{origin}: {section} must be a section with keys, [{section}]")
        for key, value in keys.items():
            dotted = f"{section}.{key}"
            if dotted not in origins:
                known = [name.partition(".")[2] for name in origins if name.startswith(f"{section}.")]
                raise ConfigError(f"{origin}: unknown key {dotted}{_nearest(key, known, section)}")
            values.setdefault(section, {})[key] = value
            origins[dotted] = origin


def _nearest(name: str, known: set[str] | list[str], section: str = "") -> str:
    found = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
    return f"; did you mean {section + '.' if section else ''}{found[0]}?" if found else ""


def _nested(section: str, key: str, value: Any) -> dict[str, Any]:
    return {section: {key: value}}


def _environment(environ: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for name in sorted(environ):
        if name in _nearly_keys():
            raise ConfigError(f"{name} sets nothing: did you mean {_nearly_keys()[name]}?")
        if name.startswith(ENV_PREFIX) and ENV_SEPARATOR in name:
            try:
                environ[name].encode()
            except UnicodeEncodeError:
                raise ConfigError(f"{name} holds a byte that is not UTF-8: set it anew") from None
            yield name, environ[name]


def _key_of_variable(name: str) -> tuple[str, str]:
    section, _, key = name.removeprefix(ENV_PREFIX).lower().partition(ENV_SEPARATOR)
    return section, key


def _parse(text: str) -> Any:
    """A variable's text as TOML would read it; bare words are strings."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def _explain(error: msgspec.ValidationError, origins: Mapping[str, str]) -> str:
    what, _, where = str(error).partition(" - at `$.")
    dotted = where.rstrip("`").partition("[")[0]  # [2] of a list
    origin = origins.get(dotted, "the configuration")
    allowed = allowed_words().get(dotted)
    return f"{dotted or 'rig.toml'}: {what}{f'; it must be {allowed}' if allowed else ''} (set by {origin})"


def key_docs(struct: type[msgspec.Struct]) -> dict[str, str]:
    """The docstring under each field of a struct, by field name, as one line each."""
    body = ast.parse(textwrap.dedent(inspect.getsource(struct))).body[0]
    assert isinstance(body, ast.ClassDef)
    docs: dict[str, str] = {}
    for field, below in zip(body.body, body.body[1:], strict=False):
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str):
            docs[field.target.id] = " ".join(below.value.value.split())
    return docs
