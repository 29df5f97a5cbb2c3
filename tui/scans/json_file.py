"""Reads a JSON object from a file of another process; a missing, too large or broken file is an empty object."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from acquire.contract.files import read_text

MAX_BYTES = 16 * 1024 * 1024


def read_object(path: Path) -> dict[str, Any]:
    """The object in the file; its contents never raise."""
    try:
        found = json.loads(read_text(path, MAX_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
