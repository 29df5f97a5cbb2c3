"""The folder of scans."""
