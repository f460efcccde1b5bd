"""Base error of all codecs: each wire has a subclass that keeps the evidence."""


class ProtocolError(Exception):
    """Bytes that a codec refuses, or a value that it cannot encode."""
