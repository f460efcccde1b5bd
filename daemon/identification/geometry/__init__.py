"""Geometry of the arm from measured poses of the tcp."""
