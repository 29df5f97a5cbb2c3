"""Points to browsers."""
