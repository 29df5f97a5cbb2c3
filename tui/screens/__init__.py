"""The screens of the console: the rig, and the dialogs above it."""
