"""The worker: live reconstruction."""
