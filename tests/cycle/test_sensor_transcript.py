"""What becomes of a sample behind its wire: whether its sensor can be believed, to the last digit.

The laws are those of docs/reliability.md, here with their numbers written out and tried on both
sides; ``cycle/test_sensor_health.py`` has them on sensors that measure. See ``transcripts``.
"""

import pytest
from transcripts import Chance, Transcript

from linemate.daemon.cycle.sensing.sensor_health import (
    CameraHealth,
    Conditions,
    DistanceHealth,
    Health,
    WrenchHealth,
)
from linemate.protocol.stamped_samples import CameraSample, DistanceSample, WrenchSample

MS = 1_000_000
QUIET = Conditions(moving=False, deviation=0.25e-3)
MOVING = Conditions(moving=True, deviation=0.25e-3)


def test_three_bad_of_the_last_five_put_a_sensor_out_and_two_do_not() -> None:
    spread = Health()
    accepted = [spread.judge(n * MS, None if good else "bad") for n, good in enumerate([0, 1, 0])]
    assert accepted == [False, True, False]
    assert spread.reason is None
    assert not spread.judge(3 * MS, "worse")
    assert (spread.reason, spread.since_ns, spread.outs, spread.refused) == ("worse", 3 * MS, 1, 3)
    forgotten = Health()
    for n, good in enumerate([0, 0, 1, 1, 1, 0, 1, 0, 1, 1, 0, 1, 0]):
        assert forgotten.judge(n * MS, None if good else "bad") is bool(good)
    assert forgotten.reason is None


@pytest.mark.parametrize(("passed_ns", "is_out"), [(99_999_999, False), (100_000_000, True)])
def test_two_bad_samples_and_nothing_else_for_100_ms_put_it_out(
    passed_ns: int, is_out: bool
) -> None:
    health = Health()
    health.judge(0, "bad")
    health.judge(passed_ns, "bad")
    assert (health.reason is not None) is is_out
    interrupted = Health()
    interrupted.judge(0, "bad")
    assert interrupted.judge(1, None)
    interrupted.judge(passed_ns, "bad")
    assert interrupted.reason is None


def test_the_tenth_good_sample_in_a_row_lets_it_back_in_and_begins_a_new_account() -> None:
    health = Health()
    for n in range(3):
        health.judge(n, "bad")
    assert not any(health.judge(10 + n, None) for n in range(9))
    health.judge(20, "bad")
    assert not any(health.judge(30 + n, None) for n in range(9))
    assert health.reason == "bad"
    assert health.judge(39, None)
    assert (health.reason, health.since_ns, health.outs, health.refused) == (None, 39, 1, 22)
    assert not health.judge(40, "again")
    assert not health.judge(41, "again")
    assert health.reason is None
    health.exclude(42, "by hand")
    health.exclude(43, "twice")
    assert (health.reason, health.since_ns, health.outs) == ("by hand", 42, 2)
    assert health.status(1_234_567_942) == {
        "out": "by hand",
        "since_s": 1.235,
        "refused": 24,
        "outs": 2,
    }
    assert Health().status(7) == {"out": None, "since_s": None, "refused": 0, "outs": 0}


def at_rest(samples: int, apart_ms: int = 10) -> tuple[DistanceHealth, int]:
    """A conveyor that stands at 1 m, and the stamp of its last reading."""
    health = DistanceHealth()
    for n in range(samples):
        assert health.accepts(DistanceSample(n * apart_ms * MS, 1.0), QUIET)
    return health, (samples - 1) * apart_ms * MS


@pytest.mark.parametrize(
    ("samples", "pause_ms", "deviation", "borne"),
    [
        # Counted from the middle one of the last three: 10 ms more than the pause.
        (40, 10, 0.25e-3, 0.03 + 0.5 * 0.02**2),
        (40, 990, 0.25e-3, 0.03 + 0.5 * 1.0**2),
        (40, 1990, 0.25e-3, 0.03 + 0.5 * 2.0**2),
        (40, 10, 0.01, 0.06 + 0.5 * 0.02**2),
        (40, 10, 0.004, 0.03 + 0.5 * 0.02**2),
        (3, 10, 0.25e-3, 0.03 + 0.5 * 0.02**2 + 1.0 * 0.02),
        (5, 490, 0.25e-3, 0.03 + 0.5 * 0.5**2 + 1.0 * 0.5),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_distance_may_be_off_by_so_much_and_no_more(
    samples: int, pause_ms: int, deviation: float, borne: float, sign: float
) -> None:
    for share, is_believed in ((0.999, True), (1.001, False)):
        health, last_ns = at_rest(samples)
        sample = DistanceSample(last_ns + pause_ms * MS, 1.0 + sign * share * borne)
        assert health.accepts(sample, Conditions(moving=False, deviation=deviation)) is is_believed


def test_two_readings_are_too_few_to_call_a_third_one_a_jump() -> None:
    health, last_ns = at_rest(2)
    assert health.accepts(DistanceSample(last_ns + 10 * MS, 50.0), QUIET)
    assert not health.accepts(DistanceSample(last_ns + 20 * MS, 50.0), QUIET)


@pytest.mark.parametrize(("samples", "is_known"), [(5, False), (6, True)])
def test_the_speed_is_known_from_six_readings_over_150_ms(samples: int, is_known: bool) -> None:
    health, last_ns = at_rest(samples, apart_ms=50)
    far = DistanceSample(last_ns + 50 * MS, 1.0 + 0.03 + 0.5 * 0.1**2 + 0.09)
    assert health.accepts(far, QUIET) is not is_known
    close, last_ns = at_rest(16)
    near = DistanceSample(last_ns + 10 * MS, 1.0 + 0.045)
    assert close.accepts(near, QUIET)  # 130 ms from middle to middle
    close, last_ns = at_rest(18)
    near = DistanceSample(last_ns + 10 * MS, 1.0 + 0.045)
    assert not close.accepts(near, QUIET)  # 150 ms


def moving(speed: float, unit: float = 0.0) -> tuple[DistanceHealth, int, float]:
    """A conveyor that is read every 10 ms, without noise: its health, last stamp and place."""
    health, place = DistanceHealth(), 0.0
    for n in range(60):
        place = speed * n * 0.01
        place = round(place / unit) * unit if unit else place
        assert health.accepts(DistanceSample(n * 10 * MS, place), QUIET)
    return health, 59 * 10 * MS, place


@pytest.mark.parametrize(("speed", "is_stuck"), [(0.0499, False), (0.0501, True), (-0.0501, True)])
def test_what_was_quicker_than_50_mm_a_second_and_stands_for_150_ms_is_stuck(
    speed: float, is_stuck: bool
) -> None:
    health, last_ns, place = moving(speed)
    assert all(
        health.accepts(DistanceSample(last_ns + n * 10 * MS, place), QUIET) for n in range(15)
    )
    assert health.accepts(DistanceSample(last_ns + 149_999_999, place), QUIET)
    assert health.accepts(DistanceSample(last_ns + 150_000_000, place), QUIET) is not is_stuck


@pytest.mark.parametrize(("unit", "longest_ms"), [(0.01, 150), (0.03, 450)])
def test_a_coarse_sensor_stands_for_the_time_of_one_and_a_half_units(
    unit: float, longest_ms: int
) -> None:
    health, last_ns, place = moving(0.1, unit)
    changed_ns = next(
        n * 10 * MS for n in range(60) if round(0.1 * n * 0.01 / unit) * unit == place
    )
    accepted = [
        health.accepts(DistanceSample(changed_ns + ms * MS, place), QUIET)
        for ms in range((last_ns - changed_ns) // MS + 1, longest_ms + 40)
    ]
    first = accepted.index(False) + (last_ns - changed_ns) // MS + 1
    # The speed of a staircase is known no better.
    assert first == pytest.approx(longest_ms, rel=0.1)
    assert first >= 150


def image(n: int, x: float, w: float = 1.0) -> CameraSample:
    return CameraSample(n, n, "c", "camera", "hub", n, (x, 0.0, 1.0), (w, 0.0, 0.0, 0.0))


def test_the_fourth_pose_alike_puts_a_camera_out_at_once() -> None:
    health = CameraHealth()
    assert [health.accepts(image(n, 0.5), MOVING) for n in range(4)] == [True] * 3 + [False]
    assert health.reason == "4 poses alike"
    assert health.outs == 1
    turned = CameraHealth()
    assert all(turned.accepts(image(n, 0.5, 1.0 - 1e-9 * n), MOVING) for n in range(20))
    # Each standstill begins again.
    for n in range(12):
        assert turned.accepts(image(n, 0.5), Conditions(n % 3 != 0, 0.0))
    assert turned.refused == 0


def test_eight_refused_poses_in_a_row_contradict_and_seven_do_not() -> None:
    health = CameraHealth()
    for _ in range(7):
        health.add_result(1, 1)
    health.add_result(0, 0)
    assert not health.contradicts
    health.add_result(1, 2)
    assert health.contradicts
    many = CameraHealth()
    many.add_result(3, 3)
    many.add_result(4, 4)
    assert not many.contradicts
    many.add_result(2, 1)
    many.add_result(7, 7)
    assert not many.contradicts
    many.add_result(1, 1)
    assert many.contradicts


def felt(n: int, force: float, torque: float = 0.0) -> WrenchSample:
    return WrenchSample(n, (0.0, force, 0.0), (0.0, 0.0, torque))


def test_the_25th_wrench_alike_puts_a_sensor_out_at_once() -> None:
    health = WrenchHealth()
    accepted = [health.accepts(felt(n, 7.0), MOVING) for n in range(25)]
    # From the fourth on none is used, the 25th excludes the sensor.
    assert accepted == [True] * 3 + [False] * 22
    assert (health.reason, health.outs) == ("25 wrenches alike", 1)
    assert not health.accepts(felt(30, 8.0), MOVING)
    twisted = WrenchHealth()
    assert all(twisted.accepts(felt(n, 7.0, 1e-9 * n), MOVING) for n in range(60))
    for n in range(100):
        twisted.accepts(felt(n, 7.0), Conditions(n % 24 != 0, 0.0))
    assert twisted.reason is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_hundred_thousand_newtons_are_measured_and_more_is_not(sign: float) -> None:
    for force, torque, is_believed in (
        (1e5, 0.0, True),
        (1.00001e5, 0.0, False),
        (0.0, 1e5, True),
        (0.0, 1.00001e5, False),
    ):
        assert WrenchHealth().accepts(felt(0, sign * force, sign * torque), MOVING) is is_believed


def _distances(transcript: Transcript, chance: Chance) -> None:
    health, stamp_ns, place, speed = DistanceHealth(), 0, 0.5, 0.1
    unit = chance.pick((0.0, 1e-4, 1e-3, 1e-2, 2e-2))
    stuck, reading = 0, place
    for _ in range(300):
        passed_ms = chance.pick((10, 10, 10, 10, 10, 10, 10, 10, 30, 150))
        stamp_ns += passed_ms * MS
        place += speed * passed_ms * 1e-3
        if chance.happens(0.02):
            speed = chance.pick((0.0, 0.049, 0.051, 0.1, -0.1))
        stuck = stuck - 1 if stuck else chance.pick((0,) * 60 + (10, 20, 40))
        shown = place if unit == 0.0 else round(place / unit) * unit
        if chance.happens(0.05):
            shown += chance.pick((0.029, 0.031, -0.035, 0.05, 0.06, 1.0))
        if not stuck:
            reading = shown
        sample = DistanceSample(stamp_ns, reading if stuck else shown)
        deviation = chance.pick((0.25e-3, 0.25e-3, 0.004, 0.006))
        transcript.say(health.accepts(sample, Conditions(moving=False, deviation=deviation)))
        transcript.say(health.status(stamp_ns + 5 * MS))


def test_distances_are_believed_as_they_always_were() -> None:
    transcript = Transcript()
    for script in range(25):
        _distances(transcript, Chance(f"belief/{script}"))
    assert transcript.digest == "2c6f718f2a26313d"
