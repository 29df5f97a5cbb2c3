"""What a key of rig.toml may hold, in words; taken from the types of the model."""

from __future__ import annotations

import functools
from typing import Any

import msgspec.inspect as types

from .model import RigConfig


@functools.cache
def allowed_words() -> dict[str, str]:
    """``section.key`` -> such as ``one of legacy, simulated, uno`` or ``a number above 0, at most 1000``."""
    found = {}
    for section in _fields(types.type_info(RigConfig)):
        for key in _fields(section.type):
            found[f"{section.name}.{key.name}"] = _words(key.type)
    return found


def _fields(struct: types.Type) -> tuple[types.Field, ...]:
    assert isinstance(struct, types.StructType)
    return struct.fields


def _words(kind: types.Type) -> str:
    match kind:
        case types.LiteralType(values=values):
            return "one of " + ", ".join(str(value) for value in values)
        case types.BoolType():
            return "true or false"
        case types.FloatType() | types.IntType():
            return ("a whole number" if isinstance(kind, types.IntType) else "a number") + _bounds(kind)
        case types.StrType(max_length=longest, pattern=pattern):
            return f"text of at most {longest} characters" + (", none of them a control character" if pattern else "")
        case types.TupleType(item_types=items):
            return f"a list of {len(items)}, each {_words(items[0])}"
    raise TypeError(f"a key of the type {kind} has no words yet")


def _bounds(kind: types.FloatType | types.IntType) -> str:
    least = [f" above {_number(kind.gt)}"] if kind.gt is not None else []
    least += [f" from {_number(kind.ge)}"] if kind.ge is not None else []
    most = [f" to {_number(kind.le)}" if kind.ge is not None else f", at most {_number(kind.le)}"]
    return "".join(least + (most if kind.le is not None else []))


def _number(value: Any) -> str:
    return f"{value:_}".replace("_", " ") if isinstance(value, int) else f"{value:g}"
