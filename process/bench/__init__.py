"""Benchmarks of the processing."""
