"""Key files: CURVE pairs readable by their owner only, and the list of allowed public keys.

Secrets are never logged, printed or sent; public keys may be shown.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import tomli_w
import zmq

from acquire.contract.config.load import LoadedConfig, home_resolved, user_config_folder
from acquire.contract.errors import ConfigError
from acquire.contract.files import read_text, replace_file

May = Literal["steer", "watch"]
SYSTEM_CONFIG = Path("/etc/sweepscope")
SERVER_KEY_NAME, OWN_KEY_NAME, ALLOWED_NAME = "server.key", "own.key", "allowed.toml"
SERVICE_USER = "sweepscope"
_Z85 = re.compile(r"^[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}$")
_NAME = re.compile(r"^[\w.@-]{1,64}$")


@dataclass(frozen=True)
class KeyPair:
    """A CURVE pair in Z85."""

    public: str
    secret: str

    def __repr__(self) -> str:
        """Without the secret, which must not be printed or logged by accident."""
        return f"KeyPair({self.public})"


@dataclass(frozen=True)
class Allowed:
    """One allowed key."""

    key: str
    """Public key in Z85."""
    may: May
    """``steer``: everything an operator may; ``watch``: listen only."""


def own_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Folder of a user's key."""
    return user_config_folder(environ) / "keys"


def rig_folder(config: LoadedConfig) -> Path:
    """Folder of the rig's key and the list of allowed keys; of an installed rig, beside its rig.toml."""
    if config.rig.network.keys_dir:
        return home_resolved(config.rig.network.keys_dir, "network.keys_dir")
    if config.path is not None and config.path.parent == SYSTEM_CONFIG:
        return SYSTEM_CONFIG / "keys"
    return own_folder()


def signature_of(public: str) -> str:
    """Short digest of a key that is appended to a remote client's name, so that names are unique."""
    return f" via key {hashlib.sha256(public.encode()).hexdigest()[:8]}"


def check_public(text: str) -> str:
    """Check a public key and return it.

    Raises:
        ConfigError: it is not a key.
    """
    if not _Z85.match(text):
        raise ConfigError(f"{text[:60]!r} is no public key: it has 40 signs, as 'sweepscope keys make' prints them")
    return text


def make_pair(path: Path, *, force: bool = False) -> KeyPair:
    """Create a pair in a file of mode 0600; under /etc it belongs to the services' user.

    Raises:
        ConfigError: there is one already (and ``force`` is False), or it cannot be written.
    """
    if path.exists() and not force:
        raise ConfigError(f"{path} is there already: who knows its public key goes on with it; --force replaces it")
    public, secret = _fresh_pair()
    text = tomli_w.dumps({"public": public, "secret": secret})
    try:
        _make_folder(path.parent)
        text = "# secret: whoever reads this file can be you\n" + text
        replace_file(path, text.encode(), durable=True, mode=0o600)
        if path.is_relative_to(SYSTEM_CONFIG) and os.getuid() == 0:
            with suppress(LookupError):
                shutil.chown(path, SERVICE_USER, SERVICE_USER)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}; use sudo for the rig's key") from None
    return KeyPair(public, secret)


def _fresh_pair() -> tuple[str, str]:
    while True:
        public, secret = (key.decode() for key in zmq.curve_keypair())
        if not public.startswith("-"):  # on the command line it would be taken for an option
            return public, secret


def load_pair(path: Path, what: str, fix: str) -> KeyPair:
    """Read a pair.

    Raises:
        ConfigError: not there, not readable, open to others, or no pair; the text says how to fix it.
    """
    try:
        if stat.S_IMODE(path.stat().st_mode) & 0o077:
            raise ConfigError(f"{what} {path} can be read by others: make a new one, or chmod 600 {path}")
        fields = tomllib.loads(read_text(path))
        pair = KeyPair(str(fields["public"]), str(fields["secret"]))
        if not _Z85.match(pair.public) or not _Z85.match(pair.secret):
            raise ValueError("no pair")  # do not show the line: half of it is secret
        return pair
    except FileNotFoundError:
        raise ConfigError(f"{what} {path} is not there: {fix}") from None
    except (OSError, ValueError, KeyError, RecursionError) as error:
        raise ConfigError(f"{what} {path} cannot be used ({type(error).__name__}): {fix}") from None


def load_allowed(folder: Path) -> dict[str, Allowed]:
    """Allowed keys by name; none if there is no list.

    Raises:
        ConfigError: the list cannot be read; no key is allowed then.
    """
    path = folder / ALLOWED_NAME
    try:
        entries = tomllib.loads(read_text(path))
        return {name: _entry(name, fields) for name, fields in entries.items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"{path} cannot be used ({error}): nobody is let in; fix it, or remove it") from None


def _entry(name: str, fields: object) -> Allowed:
    if not isinstance(fields, dict) or fields.get("may") not in ("steer", "watch"):
        raise ValueError(f"{name} needs key and may = 'steer' or 'watch'")
    return Allowed(check_public(str(fields["key"])), cast(May, fields["may"]))


def allow(folder: Path, name: str, key: str, may: May) -> None:
    """Allow a key; an existing name gets the new key.

    Raises:
        ConfigError: no name, no key, or the list cannot be written.
    """
    if not _NAME.match(name):
        raise ConfigError(f"{name[:60]!r} is no name for a key: letters, digits, . _ @ - only, at most 64")
    _save(folder, load_allowed(folder) | {name: Allowed(check_public(key), may)})


def revoke(folder: Path, name: str) -> None:
    """Remove a key from the list.

    Raises:
        ConfigError: no such name, or the list cannot be written.
    """
    entries = load_allowed(folder)
    if name not in entries:
        raise ConfigError(f"no key is allowed under the name {name[:60]!r}: see 'sweepscope keys list'")
    _save(folder, {other: entry for other, entry in entries.items() if other != name})


def _save(folder: Path, entries: Mapping[str, Allowed]) -> None:
    path = folder / ALLOWED_NAME
    text = tomli_w.dumps({name: {"key": entry.key, "may": entry.may} for name, entry in entries.items()})
    try:
        _make_folder(folder)
        text = "# public keys that are let in over TCP; 'sweepscope keys' writes this\n" + text
        replace_file(path, text.encode(), durable=True, mode=0o644)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}; use sudo for the rig's list") from None


def _make_folder(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True, mode=0o755 if folder.is_relative_to(SYSTEM_CONFIG) else 0o700)
