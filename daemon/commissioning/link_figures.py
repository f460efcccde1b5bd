"""Links in a recording: samples found, rate, gaps, age, noise and stamps of each device.

Invariants:
- Pure. A gap counts against the time-out that stops the robot in production.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal, ReportLine

LEAST_SAMPLES = 10
LEAST_S = 2.0  # of a recording that judges links


def find_links(
    inputs: Sequence[Inputs], settings: WatchSettings, expected: Sequence[str]
) -> list[ReportLine]:
    """Return what a recording says of each link.

    Args:
        settings: time-outs of the sensors.
        expected: configured sensors: distance, camera, force_torque.
    """
    span = (inputs[-1].stamp_ns - inputs[0].stamp_ns) * 1e-9 if inputs else 0.0
    if span < LEAST_S:
        reason = f"a recording of {span:.1f} s, at least {LEAST_S:.0f} s are needed"
        return [ReportLine("links", "", 1.0, Refusal(reason))]
    lines = [*_robot(inputs)]
    limits = {
        "distance": settings.one_sensor_s,
        "camera": settings.one_sensor_s,
        "force_torque": settings.wrench_s,
    }
    for name in expected:
        lines += _sensor(name, inputs, limits[name])
    return lines


def _robot(inputs: Sequence[Inputs]) -> Iterator[ReportLine]:
    stamps = np.array([x.robot.stamp_ns for x in inputs if x.robot is not None]) * 1e-9
    if len(stamps) < LEAST_SAMPLES:
        reason = "no telegrams of the robot. Start the controller's programme"
        yield ReportLine("robot telegrams", "Hz", 1.0, Refusal(reason))
        return
    gaps = np.diff(stamps)
    usual = float(np.median(gaps))
    missed = int(np.sum(gaps > 1.5 * usual))
    yield ReportLine(
        "robot telegrams", "Hz", 1.0, Estimate(1.0 / usual, 0.0, f"{len(stamps)} telegrams")
    )
    yield ReportLine(
        "robot jitter", "ms", 1e3, Estimate(float(gaps.std()), 0.0, f"{missed} late or missing")
    )
    delays = [x.robot.delay for x in inputs if x.robot is not None and x.robot.delay is not None]
    if delays:
        grown = delays[-1] - delays[0]
        outcome: Outcome = Estimate(float(grown), 0.0, "counted by the controller")
        if grown > 0:
            outcome = Refusal(
                f"the controller counted {grown} late replies, 0 are allowed. "
                "Run `linemate doctor` and check the network"
            )
        yield ReportLine("robot late replies", "", 1.0, outcome)


def _sensor(name: str, inputs: Sequence[Inputs], limit_s: float) -> Iterator[ReportLine]:
    stamps, values, exposures = _samples(name, inputs)
    if len(stamps) < LEAST_SAMPLES:
        reason = f"{len(stamps)} samples. Check the device, its section and `linemate status`"
        yield ReportLine(name, "Hz", 1.0, Refusal(reason))
        return
    gaps = np.diff(stamps)
    usual = float(np.median(gaps))
    span = float(stamps[-1] - stamps[0])
    basis = f"{len(stamps)} samples"
    yield ReportLine(f"{name} rate", "Hz", 1.0, Estimate((len(stamps) - 1) / span, 0.0, basis))
    longest = float(gaps.max())
    outcome: Outcome = Estimate(longest, 0.0, f"usually {1e3 * usual:.1f} ms")
    if longest > limit_s:
        outcome = Refusal(f"{longest:.3f} s without a sample, time-out {limit_s:.3f} s")
    yield ReportLine(f"{name} longest gap", "ms", 1e3, outcome)
    if len(exposures):
        ages = stamps - exposures
        basis = f"at most {1e3 * float(ages.max()):.0f} ms, by the sender's stamps"
        age: Outcome = Estimate(float(ages.mean()), float(ages.std()), basis)
        if float(ages.min()) < 0.0:
            age = Refusal(
                f"exposures up to {-1e3 * float(ages.min()):.1f} ms after their arrival. "
                "Check that the sender states the exposure and one clock"
            )
        yield ReportLine(f"{name} age", "ms", 1e3, age)
    unit, scale = ("N", 1.0) if name == "force_torque" else ("mm", 1e3)
    basis = "between neighbouring samples; the largest axis"
    yield ReportLine(f"{name} noise", unit, scale, Estimate(_noise(values), 0.0, basis))


def _samples(name: str, inputs: Sequence[Inputs]) -> tuple[Array, Array, Array]:
    """Return arrivals (n,) [s], values (n, m), and exposures (n,) [s] or none."""
    if name == "distance":
        readings = [sample for x in inputs for sample in x.distance]
        values = np.array([(sample.position,) for sample in readings]).reshape(-1, 1)
        return _seconds([sample.stamp_ns for sample in readings]), values, np.zeros(0)
    if name == "camera":
        images = [image for x in inputs for image in x.camera]
        values = np.array([image.position for image in images]).reshape(-1, 3)
        exposures = _seconds([image.exposure_ns for image in images])
        return _seconds([image.stamp_ns for image in images]), values, exposures
    wrenches = [sample for x in inputs for sample in x.wrench]
    values = np.array([sample.force for sample in wrenches]).reshape(-1, 3)
    return _seconds([sample.stamp_ns for sample in wrenches]), values, np.zeros(0)


def _seconds(stamps_ns: Sequence[int]) -> Array:
    return np.array(stamps_ns, dtype=float) * 1e-9


def _noise(values: Array) -> float:
    """Return the deviation of a single value without its trend: second differences."""
    second = np.diff(values, n=2, axis=0)
    spread = 1.4826 * np.median(np.abs(second - np.median(second, axis=0)), axis=0)
    return float(spread.max() / np.sqrt(6.0))
