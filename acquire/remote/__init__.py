"""The way in over TCP, where the configuration names an address: keys, the gateway at the rig, the tunnel to it."""
