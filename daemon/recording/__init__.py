"""Recordings: format, writer process, reader, snapshots and replay."""
