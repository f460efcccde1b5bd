"""Commissioning of emulated cells: the time of its steps, and wrong mountings."""
