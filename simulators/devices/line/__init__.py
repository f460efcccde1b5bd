"""A line of cars in front of one robot: which car comes when, and what becomes of it."""
