"""A plane per frame."""
