"""Where the bits of a whole number lie in a CAN frame, found once, read and written at once.

Law of this file: only what is plain is done here, whole numbers of up to 64 bits in a message
without multiplexers; of everything else it says None, and cantools is asked. What it gives is
what cantools gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from cantools.database.can import Message, Signal

MAX_BITS = 64


@dataclass(frozen=True, slots=True)
class Bits:
    """One number's place.

    Attributes:
        order: which end of the frame comes first.
        length: bytes of the message.
        mask: its bits, shifted down.
        sign: its highest bit if that means a negative number, else 0.
    """

    order: Literal["little", "big"]
    length: int
    shift: int
    mask: int
    sign: int

    def read(self, data: bytes) -> int:
        """Return the number; the frame is long enough."""
        raw = int.from_bytes(data[: self.length], self.order) >> self.shift & self.mask
        return (raw ^ self.sign) - self.sign

    def fits(self, count: int) -> bool:
        """Tell whether the place is wide enough for a number."""
        return -self.sign <= count <= (self.sign - 1 if self.sign else self.mask)

    def put(self, count: int) -> bytes:
        """Return a frame with nothing but this number in it; it fits."""
        return ((count & self.mask) << self.shift).to_bytes(self.length, self.order)


def find(message: Message, names: Sequence[str]) -> dict[str, Bits] | None:
    """Find the places of some signals.

    Returns:
        Their places by name; None if one of them is not plain.
    """
    if message.is_multiplexed():
        return None
    found = {s.name: _bits(s, message.length) for s in message.signals if s.name in names}
    plain = {name: bits for name, bits in found.items() if bits is not None}
    return plain if len(plain) == len(set(names)) else None


def _bits(signal: Signal, length: int) -> Bits | None:
    size = signal.length
    if signal.is_float or size > MAX_BITS:
        return None
    if signal.byte_order == "little_endian":
        order: Literal["little", "big"] = "little"
        shift = signal.start
    else:
        # The DBC counts a big-endian number from its highest bit, bytes upwards, bits downwards.
        order = "big"
        highest = 8 * (signal.start // 8) + 7 - signal.start % 8
        shift = 8 * length - highest - size
    if shift < 0 or shift + size > 8 * length:
        return None
    return Bits(order, length, shift, (1 << size) - 1, 1 << (size - 1) if signal.is_signed else 0)
