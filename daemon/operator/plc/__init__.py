"""``linemate plc``: an OPC UA server beside the daemon, a client of the command protocol."""
