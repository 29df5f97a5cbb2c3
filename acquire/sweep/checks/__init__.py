"""Checks that a sweep makes of itself: overlap after a resume, light during the sweep, drift at the end."""
