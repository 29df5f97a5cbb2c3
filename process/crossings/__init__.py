"""Algorithms 2 and 3: contrast mask and crossings."""
