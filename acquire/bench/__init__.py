"""Benchmarks of the rig side."""
