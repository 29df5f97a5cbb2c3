"""Folders of pictures as scans."""
