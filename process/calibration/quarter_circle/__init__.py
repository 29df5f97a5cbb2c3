"""Calibration method: the light plane from the slide's quarter circle on a white flat (equations 5 to 10 and 15)."""
