"""Reader of an slcan adapter: one system call a wake, and the decoder of ``protocol``.

python-can opens, sets up and closes the adapter. It reads single bytes, in 120 to 225 us of a
cycle.

Invariants:
    No line that is received is left unread while the descriptor is silent.
    A line that is no frame costs itself alone.
"""

import os

from linemate.protocol.sensors.slcan import CanFrame, LineDecoder, SlcanError, parse_frame

READ_BYTES = 768  # of one wake: 32 frames of 24 bytes
ENDED = "Could not read from serial device: the line ended"
_FRAMES = frozenset(b"tTrRx")
_OF_OTHERS = frozenset(b"dDbB")  # frames of CAN FD
_BELL, _CR = b"\a", b"\r"


class SlcanReader:
    """Frames of an adapter whose port has a descriptor.

    Attributes:
        garbage: lines that are no frame and no answer.
        refused: frames with more or less data than they say.
        others: frames of CAN FD, which no sensor here sends.
    """

    def __init__(self, descriptor: int) -> None:
        self.garbage = 0
        self.refused = 0
        self.others = 0
        self._descriptor = descriptor
        self._lines = LineDecoder()

    def read(self) -> list[CanFrame]:
        """Return the frames that have arrived; call it when the descriptor is readable.

        Raises:
            OSError: the line has ended.
        """
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return []
        if not data:
            raise OSError(ENDED)
        frames = []
        # The answer to a refused command ends a line as well.
        for line in self._lines.feed(data.replace(_BELL, _CR)):
            frame = self._frame(line)
            if frame is not None:
                frames.append(frame)
        return frames

    def _frame(self, line: bytes) -> CanFrame | None:
        if not line:
            return None
        kind = line[0]
        if kind in _FRAMES:
            # CANDapter writes an extended frame as x.
            try:
                return parse_frame(b"T" + line[1:] if kind == ord("x") else line)
            except SlcanError as error:
                self.refused += error.has_wrong_length
                self.garbage += not error.has_wrong_length
        elif kind in _OF_OTHERS:
            self.others += 1
        elif not line.isascii():
            self.garbage += 1
        return None
