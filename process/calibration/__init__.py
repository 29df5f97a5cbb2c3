"""Owns calibration: what the camera and the light plane are, how well that is known, and what cannot be known."""
