"""Log records on their way to the journal."""

from __future__ import annotations

import logging
import socket
import struct
from pathlib import Path

import pytest

from acquire.contract.process import logs
from tests.waiting import WALL_CLOCK_S


def record(text: str) -> logging.LogRecord:
    made = logging.LogRecord("x", logging.WARNING, "file.py", 7, text, None, None)
    logs._add_scan(made)
    return made


def fields(datagram: bytes) -> dict[str, str]:
    found, rest = {}, datagram
    while rest:
        name, _, rest = rest.partition(b"\n")
        (length,) = struct.unpack("<Q", rest[:8])
        found[name.decode()] = rest[8 : 8 + length].decode()
        rest = rest[8 + length + 1 :]
    return found


def test_a_record_reaches_the_journal_with_service_scan_and_all_its_lines(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(logs._now, "scan_uid", "")
    logs.follow_scan("abc123")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(str(run_dir / "journal"))
        journal.settimeout(WALL_CLOCK_S)
        handler = logs.JournalHandler("writer", run_dir / "journal")
        handler.emit(record("two\nlines MESSAGE=forged"))
        handler.close()
        sent = fields(journal.recv(65536))
    assert sent["MESSAGE"] == "two\nlines MESSAGE=forged"
    assert (sent["PRIORITY"], sent["SWEEPSCOPE_SERVICE"], sent["SWEEPSCOPE_SCAN_UID"]) == ("4", "writer", "abc123")


def test_a_record_that_the_journal_does_not_take_is_on_stderr(
    run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    handler = logs.JournalHandler("writer", run_dir / "nobody")
    handler.emit(record("still said"))
    handler.close()
    assert "still said" in capsys.readouterr().err


def test_only_the_stream_that_systemd_announced_is_the_journal(tmp_path: Path) -> None:
    with (tmp_path / "stream").open("w") as stream:
        found = (tmp_path / "stream").stat()
        assert logs.is_journal(stream, {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"})
        assert not logs.is_journal(stream, {"JOURNAL_STREAM": "1:1"})
        assert not logs.is_journal(stream, {})
