"""The 3D scene: floor, light, rig, and the cameras of the browsers."""
