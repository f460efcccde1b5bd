"""Python interface for researchers: runs as arrays, recordings with the truth."""
