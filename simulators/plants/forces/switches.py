"""Switches and sizes of what forces do to the car, the tool and the mount.

Invariants:
    Nested frozen dataclasses in SI (m, rad, s, N, Nm); frequencies in Hz.
    Every default is off: the world is then the study's.
    Each size has a source or is marked as an estimate.
"""

from dataclasses import dataclass

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CarrierMode:
    """A mode of the car in its carrier: m (x'' + 2 zeta w x' + w^2 x) = F - m g a.

    x is a coordinate [m]; ``direction`` and ``turn`` give what the hub does per metre of it.
    a is the true acceleration of the conveyor, ripple included; F is the contact's generalised
    force at the hub. Amplitude after a ramp of acceleration a is about g a / w^2:
    0.13 m/s^2 at 1.2 Hz gives 2.3 mm.

    Sizes: a hanger of 0.5 to 2 m is a pendulum of 0.35 to 0.7 Hz (sqrt(9.81 / l) / 2 pi);
    a stiff hanger has 1 to 5 Hz (estimate); damping 0.5 to 5 % (welded and bolted steel
    structures: EN 1998-1, ISO 10137; a rolling hanger is at the upper end). A car of
    1000 to 2000 kg on one hanger has a modal mass of 100 to 2000 kg at the hub (estimate: a
    flexible door or axle carrier is at the lower end).

    Attributes:
        frequency_hz: natural frequency without damping.
        damping: damping ratio, share of critical.
        direction: displacement of the hub per metre of the coordinate, in c.
        turn: rotation of the hub per metre of the coordinate, in c [rad/m].
        drive: share g of the conveyor's acceleration that excites the mode; 1 for a pendulum
            with its mass at the hub, 0.1 to 0.3 for a mode across the line or of yaw (estimate).
        mass: modal mass at the coordinate [kg]; 0 for a mode that no contact force moves.
        frequency_spread: half range of the frequency over the cars, share of it.
        mass_spread: half range of the mass over the cars, share of it.
    """

    frequency_hz: float = 0.62
    damping: float = 0.01
    direction: Vector3 = (0.0, 1.0, 0.0)
    turn: Vector3 = (0.0, 0.0, 0.0)
    drive: float = 1.0
    mass: float = 0.0
    frequency_spread: float = 0.0
    mass_spread: float = 0.0
