"""Algorithm 1 of the paper, and the candidates for algorithm 3: one pass over the frames of a sweep."""
