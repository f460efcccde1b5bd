"""Values of the robot's telegram and the sensor's reply, in SI units.

Invariants:
    The IPOC is kept as a number and as its digits on the wire, which are echoed.
"""

from collections.abc import Mapping

from msgspec import Struct

from linemate.protocol.stamped_samples import Vector6

Channel = float | int | bool | str  # of type DOUBLE, LONG, BOOL or STRING, in the wire's unit


class RobotTelegram(Struct, frozen=True):
    """Telegram of the controller in one cycle.

    Attributes:
        ipoc_text: its digits as received; empty: the digits of ``ipoc``.
        joints: measured A1..A6 [rad] (AIPos), None if not configured.
        joint_setpoints: programmed A1..A6 [rad] (ASPos), None if not configured.
        external: measured E1..E6 [m] linear, [rad] rotary (EIPos), None if not configured.
        external_setpoints: programmed E1..E6 (ESPos), None if not configured.
        tcp: measured x, y, z [m], a, b, c [rad] (RIst), None if not configured.
        tcp_setpoint: programmed x, y, z, a, b, c without corrections (RSol), or None.
        delay: the controller's count of late replies, None if not configured.
        channels: every other value by its name, ``"DiL"``, ``"Digout.o1"``, ``"MACur.A1"``.
    """

    ipoc: int
    ipoc_text: bytes = b""
    joints: Vector6 | None = None
    joint_setpoints: Vector6 | None = None
    external: Vector6 | None = None
    external_setpoints: Vector6 | None = None
    tcp: Vector6 | None = None
    tcp_setpoint: Vector6 | None = None
    delay: int | None = None
    channels: Mapping[str, Channel] = {}


class SensorTelegram(Struct, frozen=True):
    """Reply of the daemon in one cycle: corrections.

    Attributes:
        ipoc_text: its digits as received; empty: the digits of ``ipoc``.
        sentype: Sen/@Type; empty: the configured one.
        joints: corrections of A1..A6 [rad] (AK, AKorr), None without.
        external: corrections of E1.. [m] linear, [rad] rotary (EK, EKorr), as many as are
            configured, None without.
        channels: every other value by its name, ``"DiO"``, ``"Stop"``, ``"GPIO.01"``.
        message: text for the pendant (EStr), or None.
    """

    ipoc: int
    ipoc_text: bytes = b""
    sentype: str = ""
    joints: Vector6 | None = None
    external: tuple[float, ...] | None = None
    channels: Mapping[str, Channel] = {}
    message: str | None = None
