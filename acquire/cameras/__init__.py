"""Camera drivers behind one protocol (`protocol.py`): simulated, GenICam, webcam, replay."""
