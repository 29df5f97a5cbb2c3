"""Remote access over TCP (off by default): keys, the gateway at the rig, the client's tunnel."""
