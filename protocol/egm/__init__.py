"""ABB Externally Guided Motion: wire format, messages and codec."""
