"""Algorithms 2 and 3 of the paper: contrast mask and crossings, with sigma and quality bits."""
