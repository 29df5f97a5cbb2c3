"""The page in the browser: the cloud as it grows, the state of the rig, and on a loopback page its buttons."""
