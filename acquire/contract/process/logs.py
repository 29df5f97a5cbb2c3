"""Logging of the services: records with the scan's uid to journald, without journald one line each on stderr."""

from __future__ import annotations

import logging
import os
import socket
import struct
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import IO

JOURNAL_SOCKET = Path("/run/systemd/journal/socket")
SCAN_FIELD = "SWEEPSCOPE_SCAN_UID"
SERVICE_FIELD = "SWEEPSCOPE_SERVICE"
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_now = {"scan_uid": ""}


def follow_scan(scan_uid: str) -> None:
    """Log this scan's uid with every record from now on."""
    _now["scan_uid"] = scan_uid


def set_up(service: str, *, debug: bool = False, environ: Mapping[str, str] = os.environ) -> None:
    """Send log records to the journal if stderr is its stream, else to stderr with time and name."""
    handler: logging.Handler
    if is_journal(sys.stderr, environ) and JOURNAL_SOCKET.exists():
        handler = JournalHandler(service, JOURNAL_SOCKET)
    else:
        handler = logging.StreamHandler()
        handler.setFormatter(
            logging.Formatter(f"%(asctime)s {service} %(levelname)s %(scan)s%(message)s", datefmt="%H:%M:%S")
        )
    handler.addFilter(_add_scan)
    logging.basicConfig(level=logging.DEBUG if debug else logging.INFO, handlers=[handler])


def _add_scan(record: logging.LogRecord) -> bool:
    scan_uid = _now["scan_uid"]
    record.__dict__.update(scan_uid=scan_uid, scan=f"[{scan_uid[:8]}] " if scan_uid else "")
    return True


def is_journal(stream: IO[str], environ: Mapping[str, str] = os.environ) -> bool:
    """True if the stream is the one that systemd connected to the journal (and was not redirected since)."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


class JournalHandler(logging.Handler):
    """Sends each record as one datagram in journald's native format."""

    def __init__(self, service: str, path: Path) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter("%(message)s"))
        self._service, self._path = service, str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record; to stderr where the journal does not take it."""
        fields = {
            "MESSAGE": self.format(record),
            "PRIORITY": str(next((level for least, level in _PRIORITIES if record.levelno >= least), 7)),
            "SYSLOG_IDENTIFIER": f"sweepscope-{self._service}",
            "CODE_FILE": record.pathname,
            "CODE_LINE": str(record.lineno),
            SERVICE_FIELD: self._service,
            SCAN_FIELD: getattr(record, "scan_uid", ""),
        }
        try:
            self._socket.sendto(b"".join(_field(*item) for item in fields.items() if item[1]), self._path)
        except OSError:
            print(fields["MESSAGE"], file=sys.stderr)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        super().close()


def _field(name: str, value: str) -> bytes:
    """Binary-safe form: the name, a newline, the length as 64 bits little endian, the value."""
    data = value.encode("utf-8", "replace")
    return name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"
