"""One sampling step: what a robot engineer reads. Pure; no clock, socket or log."""
