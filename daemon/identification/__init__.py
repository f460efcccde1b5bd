"""Identification: servo, tool, swing, camera and noise parameters from recordings."""
