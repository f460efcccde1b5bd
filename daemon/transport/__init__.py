"""Sockets of the tools outside the daemon: the command protocol's client and the HTTP server."""
