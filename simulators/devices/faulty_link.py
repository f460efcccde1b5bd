"""Emulated link that loses, delays, duplicates, reorders and corrupts bytes.

Invariants:
    Pure: bytes and a time in, bytes and times of arrival out.
    Each fault has its own random stream, named by seed and fault.
    Every applied fault is counted by kind.
"""

import random
import re
from collections import Counter

from linemate.simulators.devices.faults import Faults, holds
from linemate.simulators.plants.scenario import Fault

Piece = tuple[float, bytes]
"""When it arrives [s], and what."""

KINDS = frozenset(
    {
        "silence",
        "unplug",
        "loss",
        "delay",
        "jitter",
        "duplicate",
        "reorder",
        "flip",
        "truncate",
        "ipoc_flip",
        "unreadable",
        "exponent",
    }
)
TWIN_S = 0.0005
"""How long after the first one the second of two equal pieces comes [s]."""
WORST_JITTER = 8.0
"""Longest jitter, in means."""
BEHIND_S = 1e-6

_IPOC = re.compile(rb"(<IPOC>\s*)(\d+)")
_NUMBER = re.compile(rb'(?<==")-?\d+\.\d+(?=")')
NO_NUMBERS = (b"", b"1.#QNAN", b"--1.0", b"1,5", b"0x10")
"""What a value of a telegram is not."""
_DELAY = re.compile(rb"<Delay\b[^>]*>")


def stream(seed: int, fault: Fault) -> random.Random:
    """The random numbers of one fault of one run."""
    return random.Random(f"{seed}/{fault.link}/{fault.kind}/{fault.at_s!r}")  # noqa: S311 - noise


class FaultyLink:
    """One way of one link.

    Attributes:
        suffered: pieces that a fault touched, by kind.
        is_sound: no fault ever touches it: what leaves arrives, at once.
    """

    def __init__(self, link: str, faults: Faults, seed: int, *, ordered: bool = False) -> None:
        """Take the link's own faults from a scenario's.

        Args:
            ordered: a line or a bus, on which nothing overtakes anything.
        """
        self.suffered: Counter[str] = Counter()
        self._faults = [
            (fault, stream(seed, fault)) for fault in faults.of(link) if fault.kind in KINDS
        ]
        self.is_sound = not self._faults
        self._ordered = ordered
        self._last_s = float("-inf")
        self._held: bytes | None = None

    def carry(self, data: bytes, time_s: float) -> list[Piece]:
        """Send one piece.

        Args:
            time_s: when it leaves, not before the one before it [s].

        Returns:
            What arrives because of it, in the order of arrival; one that was overtaken comes
            along with the next.
        """
        pieces = [(time_s, data)]
        if self.is_sound:
            return pieces
        for fault, chance in self._faults:
            if holds(fault, time_s):
                pieces = self._suffer(fault, chance, pieces)
        overtaken, self._held = self._held, None
        if any(fault.kind == "reorder" and holds(fault, time_s) for fault, _ in self._faults):
            pieces = self._hold_back(time_s, pieces, overtaken)
        elif overtaken is not None:
            pieces.append(((pieces[-1][0] if pieces else time_s) + BEHIND_S, overtaken))
        pieces.sort(key=lambda piece: piece[0])
        return self._in_order(pieces) if self._ordered else pieces

    def _suffer(self, fault: Fault, chance: random.Random, pieces: list[Piece]) -> list[Piece]:
        match fault.kind:
            case "silence" | "unplug":
                self.suffered[fault.kind] += len(pieces)
                return []
            case "delay":
                self.suffered[fault.kind] += len(pieces)
                return [(at + fault.value, data) for at, data in pieces]
            case "jitter":
                self.suffered[fault.kind] += len(pieces)
                return [(at + _lateness(fault.value, chance), data) for at, data in pieces]
            case "reorder":
                return pieces
        changed: list[Piece] = []
        for at, data in pieces:
            struck = chance.random() < fault.value
            self.suffered[fault.kind] += struck
            if not struck:
                changed.append((at, data))
            elif fault.kind == "duplicate":
                changed += [(at, data), (at + TWIN_S, data)]
            elif fault.kind != "loss":
                changed.append((at, _spoilt(fault, chance, data)))
        return changed

    def _hold_back(
        self, time_s: float, pieces: list[Piece], overtaken: bytes | None
    ) -> list[Piece]:
        """Let the piece held back follow this one, or hold this one back."""
        if overtaken is not None:
            return [*pieces, ((pieces[-1][0] if pieces else time_s) + BEHIND_S, overtaken)]
        for fault, chance in self._faults:
            if fault.kind == "reorder" and holds(fault, time_s) and pieces:
                if chance.random() < fault.value:
                    self.suffered["reorder"] += 1
                    self._held = pieces[-1][1]
                    return pieces[:-1]
                break
        return pieces

    def _in_order(self, pieces: list[Piece]) -> list[Piece]:
        ordered: list[Piece] = []
        for at, data in pieces:
            self._last_s = max(self._last_s, at)
            ordered.append((self._last_s, data))
        return ordered


def _lateness(mean_s: float, chance: random.Random) -> float:
    if mean_s <= 0.0:
        return 0.0
    return min(chance.expovariate(1.0 / mean_s), WORST_JITTER * mean_s)


def _spoilt(fault: Fault, chance: random.Random, data: bytes) -> bytes:
    if fault.kind == "truncate":
        return data[: chance.randrange(len(data))] if data else data
    if fault.kind == "ipoc_flip":
        return _IPOC.sub(lambda match: match[1] + _flipped_number(match[2], chance), data, count=1)
    if fault.kind == "unreadable":
        return _unreadable(data, chance)
    if fault.kind == "exponent":
        return _NUMBER.sub(lambda match: b"%.12e" % float(match[0]), data)
    return flipped(data, max(1, fault.count), chance)


def _unreadable(data: bytes, chance: random.Random) -> bytes:
    """Write one value of a telegram so that it is no number; the counter stays."""
    numbers = list(_NUMBER.finditer(data))
    if not numbers:
        return data
    begin, end = chance.choice(numbers).span()
    return data[:begin] + chance.choice(NO_NUMBERS) + data[end:]


def _flipped_number(digits: bytes, chance: random.Random) -> bytes:
    number = int(digits)
    return b"%d" % (number ^ (1 << chance.randrange(max(1, number.bit_length()))))


def flipped(data: bytes, count: int, chance: random.Random) -> bytes:
    """Flip bits of a piece.

    A telegram's Delay stays: it alone shows the daemon whether its reply was applied, a flip
    there that UDP's checksum lets pass looks exactly like a lost reply.

    Returns:
        The spoilt piece.
    """
    spoilt = bytearray(data)
    spared = {i for match in _DELAY.finditer(data) for i in range(*match.span())}
    for _ in range(count if len(spoilt) > len(spared) else 0):
        place = chance.randrange(len(spoilt))
        while place in spared:
            place = chance.randrange(len(spoilt))
        spoilt[place] ^= 1 << chance.randrange(8)
    return bytes(spoilt)
