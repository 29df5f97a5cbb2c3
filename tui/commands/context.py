"""What every subcommand shares: the session of one invocation, and printing of results as words or as JSON."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from acquire.contract.config import LoadedConfig
    from tui.client import RigClient

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Session:
    """One invocation of the command line."""

    config_path: str | None
    """``--config``; None: look in the usual places."""
    debug: bool = False
    """``--debug``."""

    def config(self) -> LoadedConfig:
        """The effective configuration (raises ConfigError)."""
        from acquire.contract.config import load_config

        return load_config(self.config_path)

    def client(self) -> RigClient:
        """A client of the running daemon (raises NoServiceError)."""
        from acquire.contract.places import client_run_dir
        from tui.client import RigClient
        from tui.who import my_name_at_a_terminal

        timeout_s = self.config().rig.limits.command_s
        return RigClient(client_run_dir(), timeout_s=timeout_s, client=my_name_at_a_terminal())

    def service_run_dir(self) -> Path:
        """The directory of the services' sockets, made if it is not there."""
        from acquire.contract.places import prepare_run_dir, service_run_dir

        return prepare_run_dir(service_run_dir())

    def log_as(self, service: str) -> None:
        """Send log records to the journal, or to stderr, one line each, with the service's name."""
        from acquire.contract.logs import set_up

        set_up(service, debug=self.debug)


def json_option(function: F) -> F:
    """Add ``--json`` to a command."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")(function)


def print_json(value: Any) -> None:
    """One JSON object on stdout; structs and dataclasses become objects, NaN becomes null."""
    click.echo(json.dumps(plain(value)))


def plain(value: Any) -> Any:
    """``value`` as plain dicts, lists and scalars; NaN and infinities become None (JSON has none)."""
    import msgspec

    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif isinstance(value, msgspec.Struct):
        value = msgspec.structs.asdict(value)
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)
