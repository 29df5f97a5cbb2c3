"""Algorithm 4 of the paper: from crossings to points; cloud.ply."""
