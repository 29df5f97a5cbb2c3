"""Reads a JSON object from a file that others write; a file that is missing, too large or broken is an empty object."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

MAX_BYTES = 16 * 1024 * 1024


def read_object(path: Path) -> dict[str, Any]:
    """What the file says; never raises for what it holds."""
    try:
        if path.stat().st_size > MAX_BYTES:
            return {}
        found = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
