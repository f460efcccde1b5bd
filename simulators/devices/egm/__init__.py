"""Emulated ABB controller with Externally Guided Motion."""
