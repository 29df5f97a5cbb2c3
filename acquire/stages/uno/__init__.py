"""The stage behind our firmware."""
