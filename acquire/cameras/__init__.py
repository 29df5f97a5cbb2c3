"""Cameras behind one protocol: the simulated camera and the real ones."""
