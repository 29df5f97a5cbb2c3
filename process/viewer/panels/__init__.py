"""The widgets beside the scene."""
