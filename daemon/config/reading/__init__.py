"""Plain values to dataclasses, and the JSON schema of these."""
