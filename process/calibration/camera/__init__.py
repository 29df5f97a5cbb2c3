"""Calibration method: the camera from pictures of a board."""
