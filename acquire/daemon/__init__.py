"""The rig daemon: one loop that drives stage, camera and lamp and runs one scan at a time."""
