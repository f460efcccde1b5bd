"""A serial port that is read in portions and handed out byte by byte.

Law of this file: the same bytes in the same order as the port's own, and no more kept than the
reader takes at one wake, so that nothing waits in here while the descriptor is silent.
python-can's slcan asks for every single byte, with three system calls each.
"""

from typing import Any

MOST_BYTES = 192
"""Of the shortest frames as many as a wake takes."""


SOCKET = "://"
"""In the name of a port that is no tty."""


class ReadAhead:
    """Stands in for a pyserial port; what is not about reading goes to the port itself."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._ahead = b""
        # A socket tells only whether anything waits. Without a time-out it can be asked for more.
        is_socket = SOCKET in str(getattr(port, "portstr", ""))
        self._is_asked = is_socket and getattr(port, "timeout", None) == 0

    @property
    def in_waiting(self) -> int:
        """How many bytes can be read at once."""
        if self._is_asked and not self._ahead:
            self._ahead = bytes(self._port.read(MOST_BYTES))
        return len(self._ahead) or int(self._port.in_waiting)

    def read(self, size: int = 1) -> bytes:
        """Read as the port does, at most as many bytes as asked for."""
        if not self._ahead:
            portion = min(MOST_BYTES, int(self._port.in_waiting))
            self._ahead = bytes(self._port.read(max(size, portion)))
        taken, self._ahead = self._ahead[:size], self._ahead[size:]
        return taken

    def close(self) -> None:
        """Close the port; pyserial leaves a socket open whose other end has gone."""
        line = getattr(self._port, "_socket", None)
        self._port.close()
        if line is not None:
            line.close()

    def reset_input_buffer(self) -> None:
        """Forget what was received."""
        self._ahead = b""
        self._port.reset_input_buffer()

    def __getattr__(self, name: str) -> Any:
        """Everything else is the port's."""
        return getattr(self._port, name)
