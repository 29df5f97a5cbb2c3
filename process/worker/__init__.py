"""The worker process: live reconstruction of the running scan, from frames to points, maps and report."""
