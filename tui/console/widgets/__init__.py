"""The panes of the console; each shows values that it is given and asks for none."""
