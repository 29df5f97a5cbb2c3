"""The folder of scans: list, copy, trash."""
