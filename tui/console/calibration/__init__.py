"""Calibration in the console."""
