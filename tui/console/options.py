"""How a console is started: from the configuration, the command line and the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from acquire.contract.config.load import LoadedConfig
from tui.client.client_name import my_name, user_name
from tui.console.state.next_scan import NextScan


@dataclass(frozen=True)
class ConsoleOptions:
    """How this console was started."""

    ascii_only: bool = False
    read_only: bool = False
    """No action moves or changes the rig; STOP stays."""
    owns_rig: bool = False
    """The services end with this program, so leaving during a sweep asks first."""
    me: str = ""
    """This console's name on the rig: ``anna on pts/3``."""
    screen: str = "scan"
    """The screen that is shown first."""
    next_scan: NextScan = field(default_factory=NextScan)
    """What the next scan starts from."""
    keymap: Mapping[str, str] = field(default_factory=dict)
    """The operator's own keys by binding id."""
    data_dir: Path = field(default_factory=lambda: Path("~/sweepscope-scans").expanduser())
    """Folder of all scans."""
    theme: str = "sweepscope-dark"
    mouse: bool = False
    """Keys, screens and lists can be clicked; off by default: a lost link would leave the terminal reporting."""
    picture: str = "half"
    """``half``, ``mono`` or ``off``."""


def options_for(config: LoadedConfig) -> ConsoleOptions:
    """The options of this user's console on the rig of ``config``; flags of the command line come on top."""
    return ConsoleOptions(
        me=my_name(),
        next_scan=NextScan.of_config(config.rig, operator=user_name()),
        data_dir=config.data_dir,
    )
