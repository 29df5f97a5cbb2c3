"""viser's web server behind access control, with a bound on the bytes to each browser."""
