"""The writer: scan files, durable and verified."""
