"""notes.json beside a scan: notes written about it afterwards. The scan file itself is never changed."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from acquire.contract.errors import ScanFileError
from acquire.contract.files import read_text, reason, replace_file

from .dataset_names import NOTES_NAME

MAX_FILE_BYTES = 1024 * 1024
Label = Annotated[str, Meta(max_length=200)]


class Notes(msgspec.Struct, frozen=True):
    """Notes on a scan; text is kept as it was typed."""

    name: Label = ""
    specimen: Label = ""
    operator: Label = ""
    notes: Annotated[str, Meta(max_length=4000)] = ""
    tags: Annotated[tuple[Label, ...], Meta(max_length=50)] = ()
    edited_utc: Annotated[str, Meta(max_length=40)] = ""
    """ISO 8601 with Z; empty: as the scan recorded it, never edited."""


def notes_of(folder: Path, recorded: Mapping[str, Any]) -> Notes:
    """The edited notes of the scan in ``folder``, else what the scan ``recorded`` (its ``user`` fields).

    Raises:
        ScanFileError: notes.json is there and cannot be read.
    """
    path = folder / NOTES_NAME
    try:
        return msgspec.json.decode(read_text(path, MAX_FILE_BYTES), type=Notes)
    except FileNotFoundError:
        return _recorded(recorded)
    except (OSError, ValueError, RecursionError) as error:
        raise ScanFileError(
            f"{path} cannot be read: {reason(error)}; fix it, or remove it to see what was recorded"
        ) from None


def _recorded(fields: Mapping[str, Any]) -> Notes:
    known = {name: fields[name] for name in ("name", "specimen", "operator", "notes", "tags") if name in fields}
    try:
        return msgspec.convert(known, Notes)
    except msgspec.ValidationError:
        return Notes()  # another program's fields; the scan keeps them as they are


def write_notes(folder: Path, notes: Notes) -> Notes:
    """Write notes.json with today's ``edited_utc`` by a rename; returns what was written.

    Raises:
        ScanFileError: too long, or the folder cannot be written to; what was there is untouched.
    """
    stamped = msgspec.structs.replace(notes, edited_utc=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    path = folder / NOTES_NAME
    try:
        checked = msgspec.convert(msgspec.to_builtins(stamped), Notes)
        replace_file(path, msgspec.json.format(msgspec.json.encode(checked), indent=1) + b"\n", durable=True)
    except ValueError as error:
        raise ScanFileError(f"these notes are not kept: {error}") from None
    except OSError as error:
        raise ScanFileError(f"cannot write {path}: {error.strerror}; the notes are as they were") from None
    return checked
