"""The light plane from sweeps."""
