"""Motions for commissioning, and what they show."""
