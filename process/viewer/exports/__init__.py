"""Files that people take away from the page, and the list of scans that it can open."""
