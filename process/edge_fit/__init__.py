"""Owns the estimates of a crossing that look at more than two samples, what the noise is, and how good both are."""
