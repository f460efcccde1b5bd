"""Commissioning: steps from an installed daemon to a measured cell."""
