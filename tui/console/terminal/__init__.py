"""The terminal that the console runs in: what it can do, and its driver."""
