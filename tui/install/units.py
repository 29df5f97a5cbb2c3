"""Makes unit files for a place: pure text in, text out."""

from __future__ import annotations

from tui.install.paths import UNIT_PROGRAM, Places

_USER_KEYS = frozenset(
    (
        "Description",
        "PartOf",
        "After",
        "Before",
        "Wants",
        "StartLimitIntervalSec",
        "Type",
        "NotifyAccess",
        "ExecCondition",
        "ExecStart",
        "Restart",
        "RestartSec",
        "WatchdogSec",
        "WatchdogSignal",
        "TimeoutStartSec",
        "TimeoutStopSec",
        "KillMode",
        "RemainAfterExit",
        "SuccessExitStatus",
        "UMask",
        "RuntimeDirectory",
        "RuntimeDirectoryMode",
        "RuntimeDirectoryPreserve",
        "NoNewPrivileges",
        "LockPersonality",
        "RestrictRealtime",
        "RestrictSUIDSGID",
        "MemoryDenyWriteExecute",
        "SystemCallArchitectures",
        "SystemCallFilter",
        "SystemCallErrorNumber",
        "RestrictAddressFamilies",
        "WantedBy",
    )
)
"""What a user's own systemd can grant without root; a user's services share the user's files and devices anyway."""


def unit_text(text: str, places: Places, data_dir: str) -> str:
    """A unit of the source tree for these places.

    Args:
        text: the unit as it stands in the source tree.
        places: where the program goes.
        data_dir: folder of all scans; one outside the service's own folder is made writable.
    """
    text = text.replace(UNIT_PROGRAM, str(places.current / "bin/sweepscope"))
    if places.user:
        return _for_user(text, places)
    if "[Service]" not in text:
        return text
    text = text.replace("[Service]\n", f"[Service]\nEnvironment=SWEEPSCOPE_CONFIG={places.config}\n", 1)
    if not data_dir.startswith("/var/lib/sweepscope/"):
        text = text.replace("ProtectHome=yes", _writable(data_dir))
    return text


def _writable(data_dir: str) -> str:
    # a data folder under /home stays reachable, the rest of /home is empty
    home = "tmpfs" if data_dir.startswith(("/home/", "/root/", "/run/user/")) else "yes"
    bind = f"BindPaths={data_dir}\n" if home == "tmpfs" else ""
    return f"ProtectHome={home}\n{bind}ReadWritePaths={data_dir}"


def _for_user(text: str, places: Places) -> str:
    kept: list[str] = []
    remarks: list[str] = []
    for line in text.splitlines():
        if line.startswith("#"):
            remarks.append(line)
            continue
        key, equals, _ = line.partition("=")
        if not equals or key in _USER_KEYS:
            kept += [*remarks, line]
        remarks = []  # what is said above a line that goes, goes with it
    text = "\n".join(kept) + "\n"
    text = text.replace("WantedBy=multi-user.target", "WantedBy=default.target")
    return text.replace("[Service]\n", f"[Service]\nEnvironment=SWEEPSCOPE_CONFIG={places.config}\n", 1)
