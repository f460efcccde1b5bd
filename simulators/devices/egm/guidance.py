"""EGM's path from joint setpoints to the servos: low-pass filter, position loop, feed-forward.

The controller does not send a setpoint to the servos as it is:

    y' = 2 pi f (u - y)          LpFilter f [Hz] on the setpoint u, and alike on speedRef: w
    x' = w + clamp(g k (y - x))  PosCorrGain g, position gain k [1/s], MaxSpeedDeviation

Without speedRef, x lags a ramp by 1/(2 pi f) + 1/(g k); with it, by 1/(2 pi f). ABB says that
LpFilter filters the sensor's data; that it takes the speed as well is assumed.

Invariants:
    Pure. Both filters are exact for an input that is constant over a cycle.

Reference: ABB, Application manual: Externally Guided Motion, 3HAC073319.
"""

import math
from dataclasses import dataclass

Axes = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class GuidanceConfig:
    """Tuning of the position guidance, as EGMActJoint and EGMRunJoint take it.

    Attributes:
        lp_filter_hz: bandwidth of the setpoint's filter [Hz]; 0 switches it off.
        position_gain: proportional position gain of the controller's configuration [1/s].
        pos_corr_gain: share of it that is used, 0..1; 0 follows speedRef alone.
        max_speed_deviation: greatest correction of the speed [rad/s, m/s].
    """

    lp_filter_hz: float = 20.0
    position_gain: float = 20.0
    pos_corr_gain: float = 1.0
    max_speed_deviation: float = 1.5

    def __post_init__(self) -> None:
        """Refuse a tuning that no controller takes."""
        if not 0.0 <= self.lp_filter_hz <= 300.0 or not 0.0 < self.position_gain <= 200.0:
            raise ValueError(
                f"EGM tuning out of range: LpFilter {self.lp_filter_hz} Hz, limit 0..300; "
                f"position gain {self.position_gain} 1/s, limit 200. Correct the emulator's file."
            )
        if not 0.0 <= self.pos_corr_gain <= 1.0 or not self.max_speed_deviation > 0.0:
            raise ValueError(
                f"EGM tuning out of range: PosCorrGain {self.pos_corr_gain}, limit 0..1; "
                f"MaxSpeedDeviation {self.max_speed_deviation}, above 0. "
                "Correct the emulator's file."
            )


class Guidance:
    """Filter and position loop of all axes.

    Attributes:
        position: where the servos are sent [rad, m].
        is_clamped: MaxSpeedDeviation held something back in the last cycle.
    """

    def __init__(self, config: GuidanceConfig, cycle_s: float, start: Axes) -> None:
        """Begin at rest.

        Args:
            cycle_s: period of the exchange [s].
            start: where the robot stands [rad, m].
        """
        self.position = start
        self.is_clamped = False
        self._filtered = start
        self._speeds = (0.0,) * len(start)
        self._cycle_s = cycle_s
        filter_rate = 2.0 * math.pi * config.lp_filter_hz * cycle_s
        self._filter_share = -math.expm1(-filter_rate) if config.lp_filter_hz else 1.0
        self._loop_share = -math.expm1(-config.position_gain * config.pos_corr_gain * cycle_s)
        self._deviation = config.max_speed_deviation * cycle_s

    def advance(self, setpoints: Axes, speeds: Axes) -> Axes:
        """Go one cycle further.

        Args:
            setpoints: of the newest message [rad, m].
            speeds: speedRef of the newest message, 0 without [rad/s, m/s].

        Returns:
            Where the servos are sent at the end of the cycle [rad, m].
        """
        share, limit = self._filter_share, self._deviation
        self._filtered = tuple(
            [y + share * (u - y) for u, y in zip(setpoints, self._filtered, strict=True)]
        )
        self._speeds = tuple(
            [w + share * (given - w) for given, w in zip(speeds, self._speeds, strict=True)]
        )
        led = [x + w * self._cycle_s for x, w in zip(self.position, self._speeds, strict=True)]
        corrections = [self._loop_share * (y - x) for y, x in zip(self._filtered, led, strict=True)]
        clamped = [min(max(value, -limit), limit) for value in corrections]
        self.is_clamped = clamped != corrections
        self.position = tuple([x + change for x, change in zip(led, clamped, strict=True)])
        return self.position

    def hold(self) -> Axes:
        """Stand still where the servos were sent last."""
        self._filtered, self._speeds = self.position, (0.0,) * len(self.position)
        self.is_clamped = False
        return self.position
