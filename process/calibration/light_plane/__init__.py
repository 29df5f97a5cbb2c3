"""Calibration method: the light plane from sweeps over boards in several poses."""
