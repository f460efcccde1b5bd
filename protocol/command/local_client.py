"""Client of the local socket, without key and tag; the server is ``local_server``.

A module of its own, so that a status loads nothing of the server.
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
    """Client on the local socket."""

    def hello(self, now_ns: int) -> bytes:
        """Return the message that requests the server's clock."""
        del now_ns
        return local_body(FrameType.HELLO, 0, 0, 0)

    def close(self) -> bytes | None:
        """Return None: closing the socket ends the session."""
        return None

    def _frame(self, kind: FrameType, sequence: int, payload: bytes) -> bytes:
        return local_body(kind, 0, 0, sequence, payload)

    def _cut_genuine(self, data: bytes) -> CommandFrame:
        frame = cut_local(data, LOCAL_LIMIT_BYTES)
        if frame.type not in {FrameType.COOKIE, FrameType.REPLY, FrameType.EVENT}:
            raise CommandError("direction", frame.type.name)
        return frame

    def _on_cookie_payload(self, frame: CommandFrame) -> None:
        del frame
