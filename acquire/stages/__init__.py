"""Motion controllers behind one protocol: the simulated stage and the real ones."""
