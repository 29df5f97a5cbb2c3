"""The rig daemon: one loop that owns stage, camera and lamp and runs one scan at a time."""
