"""What the rig does while no sweep runs: preview, exposure search, pre-scan, jog, capture."""
