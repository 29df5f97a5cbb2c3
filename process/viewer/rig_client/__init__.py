"""What the page reads from the rig and sends to it, each in a thread of its own."""
