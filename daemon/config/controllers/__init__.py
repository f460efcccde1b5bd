"""Checks of the sections of controller families."""
