"""Checks of a calibration: flatness, scale, spheres, repeatability."""
