"""Algorithm 4: points."""
