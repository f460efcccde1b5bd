"""The one error every codec raises.

Any bytes at all give a value or a child of ProtocolError, nothing else. Each
wire defines its own child in its own module and keeps the evidence on it.
"""


class ProtocolError(Exception):
    """Bytes that a wire refuses, or a value that a wire cannot carry."""
