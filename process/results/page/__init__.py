"""The report of a scan for people: one HTML page with its pictures in it, readable without a network."""
