"""The daemon: one pure sampling step, and the process that carries it."""
