"""Tests of sweepscope; the folders below ``unit`` mirror those of the product."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
"""The repository."""
