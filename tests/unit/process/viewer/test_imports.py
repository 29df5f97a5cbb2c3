"""The page's process compiles nothing: its service may have no memory that is both writable and executable."""

from __future__ import annotations

import subprocess
import sys

from tests import ROOT


def test_the_viewer_imports_no_compiler() -> None:
    code = "import sys, process.viewer.service; sys.exit(', '.join({'numba', 'llvmlite'} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
