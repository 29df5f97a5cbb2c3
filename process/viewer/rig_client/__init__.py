"""Client of the rig."""
