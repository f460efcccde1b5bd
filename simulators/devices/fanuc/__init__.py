"""Emulated FANUC controller with Stream Motion."""
