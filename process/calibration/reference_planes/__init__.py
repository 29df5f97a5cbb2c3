"""Calibration method: one light plane per frame, from its edge on two known planes."""
