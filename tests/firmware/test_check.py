"""The wiring check sees what is there, and what is not."""

from __future__ import annotations

import pytest

from acquire.contract.config.model import StageConfig
from acquire.stages.uno.emulator import Emulator
from acquire.stages.uno.stage import UnoStage
from acquire.stages.wiring_check import DISTANCE_STEPS, StageCheck


class Person:
    """Does what the check asks for, on the bench."""

    def __init__(self, emulator):
        self.emulator = emulator
        self.said = []
        self.knobs = {
            "press the limit switch": "limit press",
            "release the limit switch": "limit auto",
            "press the emergency stop": "estop 1",
            "release the emergency stop": "estop 0",
        }

    def say(self, text):
        self.said.append(text)
        for words, knob in self.knobs.items():
            if text.startswith(words):
                self.emulator.knob(knob)

    def ask(self, question):
        pins = self.emulator.state()
        if "lamp lit" in question:
            return pins.lamp == 1
        if "dark" in question:
            return pins.lamp == 0
        return pins.position == 0 and pins.steps == 2 * DISTANCE_STEPS


@pytest.fixture
def rig(firmware):
    with Emulator(*firmware, pace=0.0) as emulator:
        person = Person(emulator)
        stage = UnoStage(StageConfig(kind="uno", port=emulator.port, motion_lease_ms=5000))
        yield emulator, person, StageCheck(stage, person.say, person.ask, person_s=1.0)


def test_a_well_wired_stage_passes_every_check(rig):
    _emulator, person, check = rig
    findings = check.run()
    assert [finding.wire for finding in findings if not finding.good] == []
    assert len(findings) == 7 and any("3 of 3" in line for line in person.said)


def test_a_cut_strobe_wire_and_a_dead_switch_are_named(rig):
    emulator, person, check = rig
    emulator.knob("strobes 0")
    del person.knobs["press the limit switch"]
    bad = {finding.wire: finding.saw for finding in check.run() if not finding.good}
    assert set(bad) == {"D4 LIMIT", "D8 STROBE"}
    assert "0 of 3" in bad["D8 STROBE"]


def test_a_switch_with_a_broken_wire_reads_as_pressed_and_is_named(rig):
    emulator, _person, check = rig
    emulator.knob("limit press")
    (finding,) = (finding for finding in check.run() if finding.wire == "D4 LIMIT")
    assert not finding.good and "normally closed" in finding.saw
    assert emulator.state().steps == 0
