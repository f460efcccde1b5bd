"""The emulated station, and the runs against it."""
