"""Points to browsers: coloured, grouped into nodes, thinned, sent at the pace of each connection."""
