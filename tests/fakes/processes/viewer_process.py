"""The real viewer in a process of its own, and raw knocks at its door that no library tidies up."""

from __future__ import annotations

import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from urllib.parse import parse_qs, urlsplit

from tests import ROOT
from tests.waiting import WALL_CLOCK_S, output_of, wait_for

_PROGRAM = """
import json, sys
from pathlib import Path
from acquire.contract.config.load import load_config
from process.viewer.service import run_viewer
run_viewer(load_config(overrides=json.loads(sys.argv[2])), Path(sys.argv[1]))
"""


class ViewerProcess:
    """Starts on a free port, waits for its address, and is told to end afterwards."""

    def __init__(self, run_dir: Path, overrides: Mapping[str, object] | None = None) -> None:
        import json

        settings = json.dumps({"viewer.port": 0} | dict(overrides or {}))
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-c", _PROGRAM, str(run_dir), settings],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        assert self.process.stdout is not None
        try:
            wait_for(lambda: select.select([self.process.stdout], [], [], 0.2)[0], "the viewer's address")
            self.url = self.process.stdout.readline().strip()
            assert self.url, "it ended"
        except AssertionError as error:
            self.process.kill()
            raise AssertionError(f"the viewer did not start: {error}; {self.process.communicate()[1]}") from None
        self.port = urlsplit(self.url).port or 0
        self.token = parse_qs(urlsplit(self.url).query)["token"][0]

    def cookie(self) -> str:
        """What the token is exchanged for."""
        status, headers = request(self.port, f"/?token={self.token}")
        assert status == 302
        return headers["set-cookie"].partition(";")[0]

    def end(self) -> tuple[int, str]:
        """SIGTERM; exit status and everything on stderr."""
        self.process.send_signal(signal.SIGTERM)
        _, errors = output_of(self.process)
        return self.process.returncode, errors

    def __enter__(self) -> ViewerProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


def request(port: int, target: str = "/", **headers: str) -> tuple[int, dict[str, str]]:
    """Status and headers (lower case) of one GET; ``Host`` is the own one unless given."""
    lines = {"Host": f"127.0.0.1:{port}"} | {name.replace("_", "-"): text for name, text in headers.items()}
    text = f"GET {target} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in lines.items()) + "\r\n"
    with socket.create_connection(("127.0.0.1", port), timeout=WALL_CLOCK_S) as connection:
        connection.sendall(text.encode())
        answer = b""
        while b"\r\n\r\n" not in answer:
            part = connection.recv(65536)
            if not part:
                break
            answer += part
    first, *rest = answer.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")
    found = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in rest)}
    return int(first.split()[1]), found


def upgrade(port: int, *, origin: str | None = None, host: str | None = None, cookie: str | None = None) -> int:
    """Status of a websocket handshake; 101 means that the door is open."""
    host = host or f"127.0.0.1:{port}"
    headers = {"Host": host, "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    headers |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    if origin is not None:
        headers["Origin"] = origin
    if cookie is not None:
        headers["Cookie"] = cookie
    return request(port, "/", **headers)[0]
