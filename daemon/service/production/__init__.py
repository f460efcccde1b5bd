"""The production cycle in the process: operations, variants and record files."""
