"""Shift: car after car through one cell in virtual time, driven through the command protocol."""
