"""The name by which the rig tells this client from others. Imports nothing heavy."""

from __future__ import annotations

import getpass
import os
import sys


def user_name() -> str:
    """The user's name, or number where the system knows no name."""
    try:
        return getpass.getuser().encode("utf-8", "replace").decode()
    except (KeyError, OSError):
        return f"user {os.getuid()}"


def terminal_name() -> str:
    """The terminal on stdin (``pts/3``); empty where there is none."""
    try:
        return os.ttyname(sys.stdin.fileno()).removeprefix("/dev/")
    except (OSError, ValueError):
        return ""


def my_name() -> str:
    """``anna on pts/3``: tells this client from others of the same user."""
    return f"{user_name()} on {terminal_name() or f'pid {os.getpid()}'}"[:128]


def my_name_at_a_terminal() -> str:
    """The same for a command; empty for a script, which holds nothing."""
    return my_name() if terminal_name() else ""
