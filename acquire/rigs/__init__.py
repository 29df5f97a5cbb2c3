"""A rig put together from its configuration."""
