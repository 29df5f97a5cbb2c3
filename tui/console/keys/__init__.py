"""Keys of the console: which key does what, and what a key is called."""
