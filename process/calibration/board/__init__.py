"""Boards in pictures: detection, pose, and which views are missing."""
