"""The host of the daemon: real-time requests, idle spinner, service manager."""
