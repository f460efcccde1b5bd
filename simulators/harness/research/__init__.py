"""Python interface for researchers: own classifiers, runs as arrays, recordings with the truth."""
