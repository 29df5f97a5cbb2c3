"""The simulated rig: what the optics would show for where the stage really is, and the truth beside it."""
