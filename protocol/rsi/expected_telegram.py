"""The telegram that is expected next."""

import re
from collections.abc import Callable, Sequence

from linemate.protocol.rsi.telegram_reader import MAX_TELEGRAM_BYTES


class ExpectedTelegram:
    """Accepts one counter, one Delay and a range for each joint.

    Invariants:
        It is made before the telegram comes. One match and eight comparisons are left.
        What it accepts, ``RsiCodec.parse_robot`` accepts too.
    """

    __slots__ = ("_groups", "_high", "_low", "_match", "_texts")

    def __init__(
        self,
        match: Callable[[bytes], re.Match[bytes] | None],
        groups: Sequence[int],
        texts: Sequence[bytes],
        low: Sequence[float],
        high: Sequence[float],
    ) -> None:
        """Keep the expected values.

        Args:
            match: matches a whole telegram in the shape last seen.
            groups: numbers of the joints' groups, then those of ``texts``.
            texts: Delay if there is one, and IPOC, as they must stand in the telegram.
            low: open lower bound of each joint, in the unit of the wire [deg].
            high: the upper bounds [deg].
        """
        self._match = match
        self._groups = tuple(groups)
        self._texts = list(texts)
        self._low = tuple(low)
        self._high = tuple(high)

    def matches(self, data: bytes) -> bool:
        """Return whether a datagram is the telegram."""
        match = self._match(data)
        # A datagram as long as the buffer may be incomplete.
        if match is None or len(data) >= MAX_TELEGRAM_BYTES:
            return False
        a, b, c, d, e, f, *texts = match.group(*self._groups)
        if texts != self._texts:
            return False
        low, high = self._low, self._high
        # Unrolled: a loop costs a microsecond of the turn-around.
        return (
            low[0] < float(a) < high[0]
            and low[1] < float(b) < high[1]
            and low[2] < float(c) < high[2]
            and low[3] < float(d) < high[3]
            and low[4] < float(e) < high[4]
            and low[5] < float(f) < high[5]
        )
