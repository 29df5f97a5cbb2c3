"""Blocking clients of the daemon, for the command line."""
