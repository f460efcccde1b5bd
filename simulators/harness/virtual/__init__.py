"""Virtual time: the daemon's whole service without a clock, a socket or a thread."""
