"""Rows of the realistic world: which they are, their runs, and the table of figures."""
