"""The console's input thread, and the values that it hands to the screen."""
