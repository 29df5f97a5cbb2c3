"""Commands of the daemon: their requests, who may give them, and their handlers."""
