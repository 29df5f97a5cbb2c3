"""Host and firmware agree on every number and every structure."""

from __future__ import annotations

import inspect
import re
import runpy

import pytest

from acquire.stages.uno import wire_format as wire
from tests import ROOT

FIRMWARE = ROOT / "firmware"
HEADER = (FIRMWARE / "protocol.h").read_text(encoding="utf-8")
DEFINES = {name: int(value, 0) for name, value in re.findall(r"^#define (\w+) (0x[0-9A-Fa-f]+|\d+)\b", HEADER, re.M)}
ENUMS = {
    "CMD": wire.Cmd, "MSG": wire.Msg, "RESULT": wire.Result, "STATE": wire.McuState, "HOLD": wire.McuHold,
    "STOP": wire.McuStop, "ALARM": wire.McuAlarm, "FLAG": wire.Flag, "RESET": wire.Reset, "CONFIG": wire.ConfigFlag,
    "MODE": wire.Mode,
}  # fmt: skip
NOT_IN_PYTHON = {"CMD_LAST", "FIRMWARE_VERSION", "RESULT_MEMORY", "BLOCK_OVERHEAD"}
TYPES = {"uint8_t": "B", "uint16_t": "H", "uint32_t": "I", "uint64_t": "Q", "int32_t": "i"}


def snake(name):
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def header_structs():
    bare = re.sub(r"/\*.*?\*/", "", HEADER, flags=re.S)
    for name, inside in re.findall(r"struct PACKED (\w+) \{(.*?)\};", bare, re.S):
        layout, fields = "<", []
        for kind, names in re.findall(r"(u?int\d+_t) ([^;]+);", inside):
            for field in names.split(","):
                layout += TYPES[kind]
                fields.append(field.strip())
        yield name, layout, fields


@pytest.mark.parametrize("prefix", ENUMS)
def test_every_code_has_the_same_number_on_both_sides(prefix):
    header = {
        name.removeprefix(f"{prefix}_"): value
        for name, value in DEFINES.items()
        if name.startswith(f"{prefix}_") and name not in NOT_IN_PYTHON
    }
    assert header == {member.name: member.value for member in ENUMS[prefix]}


def test_every_other_number_is_the_same_on_both_sides():
    prefixes = tuple(f"{prefix}_" for prefix in ENUMS)
    left = {name: value for name, value in DEFINES.items() if not name.startswith(prefixes)}
    left = {name: value for name, value in left.items() if name not in NOT_IN_PYTHON}
    assert len(left) > 15
    assert left == {name: getattr(wire, name) for name in left}


def test_every_structure_has_the_same_layout_on_both_sides():
    classes = {snake(name): each for name, each in inspect.getmembers(wire, inspect.isclass) if name.endswith("Body")}
    seen = set()
    for name, layout, fields in header_structs():
        body = classes[name]
        seen.add(name)
        got = body.LAYOUT.format.replace("6B", "BBBBBB").replace("6I", "IIIIII")
        assert (got, list(body.__struct_fields__)) == (layout, fields), name
    assert len(seen) >= 12


def test_the_checksum_of_the_declarations_is_the_one_that_the_firmware_will_say():
    found = runpy.run_path(str(FIRMWARE / "wire_crc.py"))["wire_crc"](HEADER)
    assert found == wire.WIRE_CRC, f"set WIRE_CRC = 0x{found:08X}"


def test_comments_do_not_count_in_the_checksum_but_numbers_do():
    wire_crc = runpy.run_path(str(FIRMWARE / "wire_crc.py"))["wire_crc"]
    assert wire_crc(HEADER.replace("/* ", "/*  more ")) == wire_crc(HEADER)
    assert wire_crc(HEADER.replace("EVENT_MEMORY 32", "EVENT_MEMORY 31")) != wire_crc(HEADER)


def test_a_value_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="GrantBody"):
        wire.GrantBody(2**31).pack()
    with pytest.raises(ValueError, match="names 2 events"):
        body = wire.ReportBody(*([0] * 15), event_count=2).pack()
        wire.unpack_report(body)


def test_the_longest_report_fits_the_longest_body():
    longest = wire.ReportBody.LAYOUT.size + wire.REPORT_EVENTS_MAX * wire.EventBody.LAYOUT.size
    assert longest <= wire.BODY_MAX
