"""Measurements on a rig."""
