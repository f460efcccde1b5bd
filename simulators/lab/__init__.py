"""Campaigns over many seeded runs: accuracy, detection, identification."""
