"""What is found at the stage's port is said in words, and each way in which a port cannot be used."""

from __future__ import annotations

import errno
import os
import socket
import threading

import pytest
import serial

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import SweepscopeError
from acquire.stages.uno import identify, ports
from acquire.stages.uno.handshake import FirmwareMismatchError
from acquire.stages.uno.identify import words_for
from acquire.stages.uno.link import LinkTiming
from acquire.stages.uno.ports import PortError, PortMissingError, choose_port, open_port
from acquire.stages.uno.serial_io import LinkLostError
from acquire.stages.uno.stage import UnoStage
from tests.fakes.serial_device import (
    SerialDevice,
    boot_loader,
    echo,
    grbl,
    marlin,
    noise,
    old_grbl,
    silence,
    slow_greeting,
)

QUICK = LinkTiming(hello_s=0.15)


def opened(port: str) -> None:
    UnoStage(StageConfig(kind="uno", port=port), timing=QUICK).open(lambda _event: None)


@pytest.fixture(autouse=True)
def short_waits(monkeypatch):
    monkeypatch.setattr(identify, "_ANSWER_S", 0.15)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (grbl, "there is GRBL 1.1h"),
        (old_grbl, "there is GRBL 0.9j"),
        (marlin, "there is Marlin 2.0.9.3"),
        (boot_loader, "boot loader of an Arduino without a program"),
        (slow_greeting, "hello, I am a thermometer.* at 9600 baud"),
        (noise, "noise"),
        (echo, "echo"),
    ],
)
def test_another_device_is_named_with_its_port_and_nothing_moved(answer, words):
    with SerialDevice(answer) as device, pytest.raises(FirmwareMismatchError, match=words) as caught:
        opened(device.port)
    assert device.port in str(caught.value) and "nothing has moved" in str(caught.value)


def test_a_silent_port_says_what_to_look_at():
    with (
        SerialDevice(silence) as device,
        pytest.raises(LinkLostError, match=rf"nothing answers .*{device.port}.*powered"),
    ):
        opened(device.port)


def test_a_port_that_vanishes_while_it_is_asked_is_named():
    with SerialDevice(silence) as device:
        threading.Timer(0.1, device.unplug).start()
        with pytest.raises(LinkLostError, match=rf"{device.port} is gone"):
            opened(device.port)


@pytest.mark.parametrize(
    ("heard", "words"),
    [
        (b"\r\nGrbl 1.1f ['$' for help]\r\n", "GRBL 1.1f"),
        (b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n", "GRBL"),
        (b"start\r\nMarlin bugfix-2.0.x\r\n", "Marlin 2.0.x"),
        (b"FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http", "Smoothieware"),
        (b"ets Jun  8 2016 00:22:57\r\n\r\nrst:0x1 (POWERON_RESET)", "an ESP32 board"),
        (b"MicroPython v1.20 on 2023\r\n>>> ", "MicroPython"),
        (b"raspberrypi login: ", "the console of a computer"),
        (b"ready\r\nready\r\n", "something that says 'ready'"),
        (b"", ""),
    ],
)
def test_greetings_are_recognised(heard, words):
    assert words_for(heard) == words


# ---- ports that are none ----


def test_a_folder_a_file_a_pipe_and_a_device_are_no_serial_port(tmp_path):
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("", "a folder"), ("file", "a file"), ("pipe", "a pipe")):
        with pytest.raises(PortError, match=f"is no serial port: it is {words}"):
            open_port(str(tmp_path / name), 115_200)
    with pytest.raises(PortError, match="/dev/null is no serial port"):
        open_port("/dev/null", 115_200)


def test_a_socket_is_no_serial_port(run_dir):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(run_dir / "s"))
        with pytest.raises(PortError, match="a socket"):
            open_port(str(run_dir / "s"), 115_200)


def test_a_name_that_is_no_file_name_is_one_sentence():
    for name in (b"/dev/tty\xff".decode("utf-8", "surrogateescape"), "/dev/" + "x" * 300):
        with pytest.raises(SweepscopeError) as caught:
            open_port(name, 115_200)
        assert "\n" not in str(caught.value)


def test_a_port_of_another_group_says_how_to_join_it(monkeypatch):
    def refuse(*_arguments, **_options):
        raise serial.SerialException(errno.EACCES, "Permission denied")

    monkeypatch.setattr(ports.serial, "Serial", refuse)
    with (
        SerialDevice(silence) as device,
        pytest.raises(PortError, match="no permission for .* belongs to group .*usermod"),
    ):
        open_port(device.port, 115_200)


def test_a_busy_port_is_said_to_be_busy():
    with SerialDevice(silence) as device:
        first = open_port(device.port, 115_200)
        with pytest.raises(PortError, match="busy"):
            open_port(device.port, 115_200)
        first.close()


# ---- which port ----


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A machine with these ports, and a /dev of its own."""

    def has(*names: str, stable: bool = False) -> str:
        stage = tmp_path / "sweepscope-stage"
        if stable:
            stage.touch()
        monkeypatch.setattr(ports, "STABLE_NAME", stage)
        monkeypatch.setattr(ports, "known_ports", lambda: list(names))
        return str(stage)

    return has


def test_the_name_that_udev_gives_the_stage_comes_before_all_others(machine):
    stage = machine("/dev/ttyUSB0", "/dev/ttyUSB1", stable=True)
    assert choose_port("") == stage
    assert choose_port("/dev/ttyUSB1") == "/dev/ttyUSB1"


def test_without_it_the_only_port_is_taken(machine):
    machine("/dev/ttyUSB0")
    assert choose_port("") == "/dev/ttyUSB0"


def test_no_port_and_several_ports_say_what_was_tried(machine):
    stage = machine()
    with pytest.raises(PortMissingError, match=f"stage.port names none, {stage} is not there.*is the cable in"):
        choose_port("")
    machine("/dev/ttyUSB0", "/dev/ttyUSB1")
    with pytest.raises(PortMissingError, match=r"/dev/ttyUSB0, /dev/ttyUSB1; set stage\.port"):
        choose_port("")
