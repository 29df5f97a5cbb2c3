"""The client side of the daemon's sockets, without a thread: command line, console and page add their own."""
