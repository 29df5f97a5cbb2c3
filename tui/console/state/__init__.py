"""What the console knows; pure."""
