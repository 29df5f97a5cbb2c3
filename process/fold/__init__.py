"""Algorithm 1: the one-pass fold."""
