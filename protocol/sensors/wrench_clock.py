"""When a wrench was measured, by the device's own clock where it has one.

Law of this file: integers in, a sample out, a bounded memory. A serial line has no kernel stamps:
on a busy host a frame is read milliseconds late, and at 106 mm/s a millisecond is 0.1 mm of a
sensor that is good for 0.05 mm. The device counts its own microseconds, and its frames can only
be late, never early: the smallest difference of the last seconds is the offset.
"""

from linemate.protocol.samples import WrenchSample
from linemate.protocol.sensors.clock_offset import ClockOffset

WRAP_US = 1 << 32
LONGEST_LATE_NS = 50_000_000
"""A frame that would be later than this was not late: the device's clock is not to be trusted."""

PROMPT_NS, STEADY_NS = 8_000_000, 40_000_000
"""Nor is it if no frame that was sent for so long by it was as prompt as this: a line that was held
up drains within a few frames, and a clock that was set back by 15 ms stays so. Believed for the
ten seconds of the window it made the contact unstable: 6 mm, and a torn mount."""


class WrenchClock:
    """Dates samples. Devices without a clock keep their arrival.

    Attributes:
        distrusted: times the device's clock was given up and learned anew.
    """

    __slots__ = ("_last_us", "_offset", "_prompt_ns", "_turns", "distrusted")

    def __init__(self, window_s: float = 10.0) -> None:
        """Know nothing; ``window_s`` is how long an offset is remembered [s]."""
        self._offset = ClockOffset(window_s)
        self._last_us: int | None = None
        self._prompt_ns: int | None = None
        self._turns = 0
        self.distrusted = 0

    def date(self, sample: WrenchSample) -> WrenchSample:
        """Return the sample with its stamp at the moment it could have arrived at the earliest."""
        if sample.device_us is None:
            return sample
        sent_ns = self._unwrapped(sample.device_us) * 1000
        dated_ns = sent_ns + self._offset.learn(sample.stamp_ns - sent_ns, sample.stamp_ns)
        late_ns = sample.stamp_ns - dated_ns
        if late_ns > LONGEST_LATE_NS or self._unprompt_ns(sent_ns, late_ns) > STEADY_NS:
            self.distrusted += 1
            self._prompt_ns = sent_ns
            self._offset.clear()
            self._offset.learn(sample.stamp_ns - sent_ns, sample.stamp_ns)
            return sample
        return WrenchSample(
            dated_ns,
            sample.force,
            sample.torque,
            sample.status,
            sample.device_us,
            sample.temperature,
        )

    def _unprompt_ns(self, sent_ns: int, late_ns: int) -> int:
        """Take one frame; return for how long, by the device's clock, none has been prompt [ns]."""
        if late_ns < PROMPT_NS or self._prompt_ns is None or sent_ns < self._prompt_ns:
            self._prompt_ns = sent_ns
        return sent_ns - self._prompt_ns

    def _unwrapped(self, device_us: int) -> int:
        """Return the device's count without its 32-bit wrap [us]."""
        if self._last_us is not None and self._last_us - device_us > WRAP_US // 2:
            self._turns += 1
        self._last_us = device_us
        return device_us + self._turns * WRAP_US
