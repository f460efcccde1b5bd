"""FANUC Stream Motion: packets, link and start of the stream."""
