"""Emulated devices on real transports: UDP, pseudo-terminals, TCP."""
