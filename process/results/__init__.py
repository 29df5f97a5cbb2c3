"""From a scan file to its results: settings, maps, cloud and report. The worker and `reconstruct` share it."""
