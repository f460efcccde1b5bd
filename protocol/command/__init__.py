"""The command protocol: requests, replies, sessions and keys."""
