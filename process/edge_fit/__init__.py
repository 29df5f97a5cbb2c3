"""Crossings from the whole edge of a pixel: erf fit, noise model, filters. Beyond the paper (docs/accuracy.md)."""
