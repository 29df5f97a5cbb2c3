"""The light plane from the quarter circle."""
