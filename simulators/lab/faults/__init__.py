"""Fault campaign (deterministic simulation testing) in virtual time."""
