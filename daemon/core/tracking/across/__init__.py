"""Across the conveyor: the filter of the object's x, z, orientation and swing."""
