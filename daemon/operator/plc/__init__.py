"""``linemate plc``: an OPC UA server next to the daemon, a client of the command protocol."""
