"""The operator's end of the local socket; local_server is the daemon's.

Law of this file: the conversation of client_core without key and tag. A file of its own,
so that a status from the shell loads nothing of the server.
"""

from linemate.protocol.command.client_core import ClientCore
from linemate.protocol.command.frame_codec import (
    LOCAL_LIMIT_BYTES,
    CommandError,
    CommandFrame,
    FrameType,
    cut_local,
    local_body,
)


class LocalClient(ClientCore):
    """A client on the local socket: no key, no tag."""

    def hello(self, now_ns: int) -> bytes:
        """Return the message that asks for the server's clock."""
        del now_ns
        return local_body(FrameType.HELLO, 0, 0, 0)

    def close(self) -> bytes | None:
        """Return None: closing the socket is enough."""
        return None

    def _frame(self, kind: FrameType, sequence: int, payload: bytes) -> bytes:
        return local_body(kind, 0, 0, sequence, payload)

    def _genuine(self, data: bytes) -> CommandFrame:
        frame = cut_local(data, LOCAL_LIMIT_BYTES)
        if frame.type not in {FrameType.COOKIE, FrameType.REPLY, FrameType.EVENT}:
            raise CommandError("direction", frame.type.name)
        return frame

    def _take_cookie(self, frame: CommandFrame) -> None:
        del frame
