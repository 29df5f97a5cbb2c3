"""Results of a scan on disk."""
