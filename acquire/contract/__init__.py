"""What every process agrees on: messages, scan files, calibration, configuration, states, faults."""
