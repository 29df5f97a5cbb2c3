"""How a service runs: clocks, run directory, logs, readiness."""
