"""The input thread."""
