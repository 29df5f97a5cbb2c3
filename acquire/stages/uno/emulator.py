"""The emulated controller: runs the built firmware in simavr with its serial port on a pty, and injects faults.

Needs the AVR tools and simavr (see firmware/README.md); nothing else in the product does.
"""

from __future__ import annotations

import contextlib
import fcntl
import shutil
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from acquire.contract.errors import SweepscopeError

FIRMWARE_DIR = Path(__file__).parents[3] / "firmware"
_TOOLS = {"make": "make", "gcc": "cc", "gcc-avr": "avr-gcc", "binutils-avr": "avr-objcopy"}
_HEADERS = {
    "avr-libc": Path("/usr/lib/avr/include/avr/io.h"),
    "libsimavr-dev": Path("/usr/include/simavr/sim_avr.h"),
    "libelf-dev": Path("/usr/include/libelf.h"),
}
"""What the build uses, by the Debian package that brings it."""
_ANSWER_S = 5.0
_BUILD_S = 300.0


class EmulatorError(SweepscopeError):
    """The emulator cannot be built or started, or does not answer."""


@dataclass(frozen=True)
class PinState:
    """Counts at the emulated pins since the start."""

    position: int
    """Where the stage truly is, in microsteps from where it stood at the start."""
    steps: int
    triggers: int
    delivered: int
    """Triggers that reached the camera."""
    lamp: int
    driver: int
    limit: int
    estop: int
    step_pin: int
    trigger_pin: int
    cycles: int
    bytes_in: int
    bytes_out: int
    hurt: int


@dataclass(frozen=True)
class TriggerEdge:
    """One rising edge of TRIGGER that reached the camera."""

    number: int
    position_steps: int
    """Where the stage truly was."""
    cycles: int


def missing_tools() -> list[str]:
    """Debian packages that the emulator needs and this machine lacks."""
    tools = [package for package, tool in _TOOLS.items() if shutil.which(tool) is None]
    return tools + [package for package, header in _HEADERS.items() if not header.exists()]


def build_firmware(build_dir: Path | None = None, *arguments: str) -> tuple[Path, Path]:
    """Build firmware and emulator; returns their paths (ELF, program).

    Raises:
        EmulatorError: a tool is missing, or the compiler complains.
    """
    missing = missing_tools()
    if missing:
        raise EmulatorError(f"the emulated stage cannot be built: apt-get install {' '.join(missing)}")
    folder = (build_dir or FIRMWARE_DIR / "build").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    command = ["make", "-s", "-C", str(FIRMWARE_DIR), f"BUILD={folder}", "all", "sim", *arguments]
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two builds at the same time must not overwrite each other
        done = subprocess.run(command, capture_output=True, text=True, timeout=_BUILD_S, check=False)
    if done.returncode != 0:
        raise EmulatorError(f"the firmware does not build: {(done.stderr or done.stdout).strip()[-500:]}")
    return folder / "stage.elf", folder / "stage-sim"


class Emulator:
    """One running emulator. ``pace`` 1 is real time, 0 as fast as possible."""

    def __init__(
        self, elf: Path, program: Path, *, pace: float = 1.0, limit_at: int = -1_000_000_000, seed: int = 1
    ) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="stage-"))
        self.port = str(self._folder / "port")
        """Lasting name of the serial port, as by-id names are."""
        self._control = str(self._folder / "control")
        arguments = ("--pace", pace, "--link", self.port, "--control", self._control, "--limit-at", limit_at)
        self._process = subprocess.Popen(
            [str(program), str(elf), *map(str, arguments), "--seed", str(seed)],
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C must not end it before the driver is closed
        )
        self._socket: socket.socket | None = None
        self._rest = b""
        self._watchers: list[TriggerWatch] = []
        try:
            assert self._process.stdout is not None
            if not self._process.stdout.readline().startswith(b"port "):
                raise EmulatorError("the emulator ended at once")
            self._socket = self.connect()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Process id of the emulator."""
        return self._process.pid

    def connect(self) -> socket.socket:
        """Open another connection to the emulator's control socket."""
        connection = socket.socket(socket.AF_UNIX)
        connection.settimeout(_ANSWER_S)
        connection.connect(self._control)
        return connection

    def knob(self, text: str) -> str:
        """Send a request of firmware/README.md (such as ``drop 3``); returns the text of the answer.

        Raises:
            EmulatorError: unknown request, or no answer.
        """
        assert self._socket is not None
        try:
            self._socket.sendall(text.encode() + b"\n")
            while b"\n" not in self._rest:
                data = self._socket.recv(4096)
                if not data:
                    raise EmulatorError("the emulator is gone")
                self._rest += data
        except OSError as error:
            raise EmulatorError(f"the emulator does not answer: {error}") from error
        line, _, self._rest = self._rest.partition(b"\n")
        if not line.startswith(b"ok"):
            raise EmulatorError(f"{text}: {line.decode()}")
        return line[3:].decode()

    def state(self) -> PinState:
        """Counts at the pins."""
        fields = dict(word.split("=", 1) for word in self.knob("state").split())
        fields.pop("port")
        return PinState(**{name: int(value) for name, value in fields.items()})

    def watch(
        self,
        on_trigger: Callable[[TriggerEdge], None],
        on_lamp: Callable[[bool], None] | None = None,
        on_dropped: Callable[[TriggerEdge], None] | None = None,
    ) -> None:
        """Call back at each real trigger edge, from a thread that ends with the emulator."""
        self._watchers.append(TriggerWatch(self.connect(), on_trigger, on_lamp, on_dropped))

    def close(self) -> None:
        """End the emulator; idempotent."""
        self._process.terminate()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(timeout=5)
        if self._process.stdout is not None:
            self._process.stdout.close()
        for watcher in self._watchers:
            watcher.close()
        if self._socket is not None:
            self._socket.close()
        shutil.rmtree(self._folder, ignore_errors=True)


class TriggerWatch:
    """Reads the emulator's reports of edges; the emulator waits for a slow reader, so none is lost."""

    def __init__(
        self,
        connection: socket.socket,
        on_trigger: Callable[[TriggerEdge], None],
        on_lamp: Callable[[bool], None] | None,
        on_dropped: Callable[[TriggerEdge], None] | None,
    ) -> None:
        self._connection = connection
        self._on_trigger, self._on_lamp, self._on_dropped = on_trigger, on_lamp, on_dropped
        connection.sendall(b"watch\n")
        if connection.recv(3) != b"ok\n":
            raise EmulatorError("the emulator cannot be watched")
        connection.settimeout(None)
        self._thread = threading.Thread(target=self._run, name="stage-watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(timeout=5)
        self._connection.close()

    def _run(self) -> None:
        with self._connection.makefile("r", encoding="ascii") as lines, contextlib.suppress(OSError):
            for line in lines:
                self._take(line.split())

    def _take(self, words: list[str]) -> None:
        if words[0] == "trigger":
            self._on_trigger(TriggerEdge(*map(int, words[1:4])))
        elif words[0] == "dropped" and self._on_dropped is not None:
            self._on_dropped(TriggerEdge(*map(int, words[1:4])))
        elif words[0] == "lamp" and self._on_lamp is not None:
            self._on_lamp(words[1] == "1")
