"""A serial port that is read in portions and handed out byte by byte.

python-can's slcan reads single bytes, with three system calls each.

Invariants:
    The same bytes in the same order as from the port.
    It keeps no more than the reader takes at one wake, so that no byte waits while the descriptor
    is silent.
"""

from typing import Any

MOST_BYTES = 192  # as many of the shortest frames as a wake takes
SOCKET = "://"  # in the name of a port that is no tty


class ReadAhead:
    """Replaces a pyserial port; calls other than for reading go to the port itself."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._ahead = b""
        # A socket reports only whether any byte waits. Without a time-out a read shows how many.
        is_socket = SOCKET in str(getattr(port, "portstr", ""))
        self._reads_to_count = is_socket and getattr(port, "timeout", None) == 0

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once."""
        if self._reads_to_count and not self._ahead:
            self._ahead = bytes(self._port.read(MOST_BYTES))
        return len(self._ahead) or int(self._port.in_waiting)

    def read(self, size: int = 1) -> bytes:
        """Return at most ``size`` bytes, as the port does."""
        if not self._ahead:
            portion = min(MOST_BYTES, int(self._port.in_waiting))
            self._ahead = bytes(self._port.read(max(size, portion)))
        data, self._ahead = self._ahead[:size], self._ahead[size:]
        return data

    def close(self) -> None:
        """Close the port and its socket, which pyserial leaves open after the peer has closed."""
        line = getattr(self._port, "_socket", None)
        self._port.close()
        if line is not None:
            line.close()

    def reset_input_buffer(self) -> None:
        """Drop what was received."""
        self._ahead = b""
        self._port.reset_input_buffer()

    def __getattr__(self, name: str) -> Any:
        """Return the port's attribute."""
        return getattr(self._port, name)
