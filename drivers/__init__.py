"""Transports in, stamped samples out: I/O and nothing else, one file a link."""
