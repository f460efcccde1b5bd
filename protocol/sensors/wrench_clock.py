"""Date wrench samples by the device's own clock, where it has one.

A serial line has no kernel stamps. A busy host reads a frame milliseconds late, and 1 ms at
106 mm/s is 0.1 mm, twice the accuracy of the sensor.

Invariants:
    A frame can be late, never early. The smallest ``arrival - sent`` of the window is the offset.
"""

from linemate.protocol.sensors.clock_offset import ClockOffset
from linemate.protocol.stamped_samples import WrenchSample

WRAP_US = 1 << 32
# The device's clock is wrong if a frame would be later than this [ns], ...
LONGEST_LATE_NS = 50_000_000
# ... or if all frames of the last STEADY_NS are later than PROMPT_NS: a delayed line drains within
# a few frames, a clock that was set back by 15 ms stays so. Used for a window of 10 s it made the
# contact unstable: an error of 6 mm.
PROMPT_NS, STEADY_NS = 8_000_000, 40_000_000
# A frame that comes twice repeats its count once, a clock that stands more often. By that clock
# frames looked up to LONGEST_LATE_NS late, over and over: a start in contact was felt 0.1 s late.
MOST_REPEATS = 1
WINDOW_S = 10.0  # in which the least delay of a frame is looked for


class WrenchClock:
    """Dates samples. Samples of devices without a clock keep their arrival.

    Attributes:
        distrusted: how often the device's clock was wrong: it stood, or its offset was dropped.
    """

    __slots__ = ("_last_us", "_offset", "_prompt_ns", "_repeats", "_turns", "distrusted")

    def __init__(self) -> None:
        self._offset = ClockOffset(WINDOW_S)
        self._last_us: int | None = None
        self._prompt_ns: int | None = None
        self._repeats = 0
        self._turns = 0
        self.distrusted = 0

    def date(self, sample: WrenchSample) -> WrenchSample:
        """Return the sample with its earliest possible arrival."""
        if sample.device_us is None:
            return sample
        self._repeats = self._repeats + 1 if sample.device_us == self._last_us else 0
        if self._repeats > MOST_REPEATS:
            self.distrusted += 1
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
        """Return for how long, on the device's clock, no frame has been prompt [ns]."""
        if late_ns < PROMPT_NS or self._prompt_ns is None or sent_ns < self._prompt_ns:
            self._prompt_ns = sent_ns
        return sent_ns - self._prompt_ns

    def _unwrapped(self, device_us: int) -> int:
        """Return the device's count without its 32-bit wrap [us]."""
        if self._last_us is not None and self._last_us - device_us > WRAP_US // 2:
            self._turns += 1
        self._last_us = device_us
        return device_us + self._turns * WRAP_US
