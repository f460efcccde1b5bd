"""Laws of the world: reproducible to the byte, indifferent to how time is cut, whole in a run."""

import math
from dataclasses import replace

import numpy as np
import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.bending.effects_arm import ArmEffects, WindupEffect
from linemate.simulators.plants.conveyor_plan import Conveyor, ConveyorEvent, Ripple
from linemate.simulators.plants.forces.switches import CarrierMode
from linemate.simulators.plants.scenario import (
    Axis,
    Body,
    Camera,
    DistanceSensor,
    Effector,
    ForceTorque,
    Robot,
    Scenario,
    Swing,
)
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World


def swaying(world: World, t: float) -> tuple[float, ...]:
    start = world.scenario.robot.start
    return tuple(q + 0.02 * math.sin(2 * t + i) for i, q in enumerate(start))


def run(scenario: Scenario, seconds: float, cuts: int = 1) -> list[object]:
    """Everything a run shows, `advance` cut into so many calls a cycle."""
    world = World(scenario)
    seen: list[object] = []
    cycles = int(seconds / scenario.cycle_s)
    for k in range(cycles):
        t = world.cycle_start(k)
        world.advance(t)
        world.command(swaying(world, t))
        for i in range(1, cuts + 1):
            world.advance(t + i * (world.cycle_start(k + 1) - t) / cuts)
            if i < cuts:
                world.deflection()
        seen.append((world.encoders()[:6], world.deflection(), world.tcp_pose().tobytes()))
    seen.append((world.take_distance(), world.take_camera(), world.take_wrench()))
    return seen


@pytest.mark.parametrize("cycle_s", [0.012, 0.004])
def test_the_same_seed_gives_the_same_bytes(cycle_s: float) -> None:
    scenario = Scenario(seed=4, cycle_s=cycle_s)
    assert repr(run(scenario, 3.0)) == repr(run(scenario, 3.0))


def test_another_seed_gives_another_world() -> None:
    assert repr(run(Scenario(seed=4), 0.5)) != repr(run(Scenario(seed=5), 0.5))


@pytest.mark.parametrize("cuts", [2, 3, 7])
def test_time_cut_differently_is_the_same_world(cuts: int) -> None:
    scenario = Scenario(
        seed=4,
        force_torque=ForceTorque(period_s=0.0017, phase=0.3),
        camera=replace(Camera(), period_s=0.0131),
    )
    assert repr(run(scenario, 2.0)) == repr(run(scenario, 2.0, cuts))


def test_one_long_advance_is_many_short_ones() -> None:
    long, short = World(Scenario(seed=2)), World(Scenario(seed=2))
    long.advance(3.0)
    for k in range(1, 5001):
        short.advance(-2.0 + k * 0.001)
    assert repr(long.take_camera()) == repr(short.take_camera())
    assert repr(long.take_distance()) == repr(short.take_distance())
    assert repr(long.take_wrench()) == repr(short.take_wrench())
    assert long.deflection() == short.deflection()


def test_changing_one_sensor_shifts_no_other() -> None:
    plain, changed = Scenario(seed=6), Scenario(
        seed=6,
        camera=Camera(dropout_rate=0.5, jitter_s=0.0),
        distance=DistanceSensor(dropout_rate=0.2),
    )  # fmt: skip
    before, after = World(plain), World(changed)
    before.advance(1.0)
    after.advance(1.0)
    assert repr(before.take_wrench()) == repr(after.take_wrench())
    whole = {e.exposure_s: e.position for e in before.take_distance()}
    left = after.take_distance()
    assert all(whole[e.exposure_s] == e.position for e in left)
    assert 0 < len(left) < len(whole)
    poses = {e.exposure_s: e.position for e in before.take_camera()}
    shared = [e for e in after.take_camera() if e.exposure_s in poses]
    assert shared
    assert all(poses[e.exposure_s] == e.position for e in shared)


def test_both_cycles_see_one_conveyor_and_one_body() -> None:
    slow, fast = (World(Scenario(seed=8, cycle_s=c)) for c in (0.012, 0.004))
    slow.advance(10.0)
    fast.advance(10.0)
    for t in np.linspace(-2, 10, 25):
        assert slow.unit_speed(float(t)) == fast.unit_speed(float(t))
        assert slow.unit_position(float(t)) == fast.unit_position(float(t))
        assert (slow.hub_pose(float(t)) == fast.hub_pose(float(t))).all()


def test_emissions_are_handed_out_when_due_once_and_in_order() -> None:
    world = World(Scenario(seed=1))
    seen = []
    for k in range(1, 1000):
        world.advance(-2.0 + 0.0033 * k)
        for emissions in (world.take_distance(), world.take_camera(), world.take_wrench()):
            for emission in emissions:
                assert -2.0 + 0.0033 * (k - 1) < emission.time_s <= -2.0 + 0.0033 * k + 2e-9
        seen += [e.exposure_s for e in world.take_wrench()]
    assert not world.take_distance()


def test_time_does_not_run_backwards() -> None:
    world = World(Scenario())
    world.advance(0.0)
    with pytest.raises(ValueError, match="time runs forward"):
        world.advance(-0.1)


def test_a_reply_late_within_its_cycle_still_counts_but_not_too_late() -> None:
    prompt, late = World(Scenario(seed=1)), World(Scenario(seed=1))
    for world, delay in ((prompt, 0.0), (late, 0.007)):
        for k in range(100):
            t = world.cycle_start(k)
            world.advance(t)
            world.advance(t + delay)
            world.command(swaying(world, t))
        world.advance(world.cycle_start(100))
    assert prompt.encoders()[:6] == late.encoders()[:6]
    axes = (*Robot().axes[:5], Axis(6.5, 0.75, 0.002, 15.0), Robot().axes[6])
    world = World(Scenario(robot=Robot(axes=axes)))
    world.advance(-2.0 + 0.005)
    with pytest.raises(ValueError, match="the motion has passed it"):
        world.command(world.scenario.robot.start)


@pytest.mark.parametrize("bad", [(0.0,) * 6, (math.nan,) + (0.0,) * 6, (math.inf,) * 7])
def test_setpoints_that_are_none_are_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="seven finite setpoints"):
        World(Scenario()).command(bad)


def test_encoder_noise_is_per_cycle_and_moves_nothing() -> None:
    axes = tuple(replace(axis, encoder_sigma=1e-4) for axis in Robot().axes)
    noisy = World(Scenario(robot=Robot(axes=axes)))  # type: ignore[arg-type]
    clean = World(Scenario())
    reads = []
    for k in range(400):
        for world in (noisy, clean):
            world.advance(world.cycle_start(k))
            world.command(swaying(world, 0.012 * k))
        joints, true = noisy.encoders()[:6], clean.encoders()[:6]
        assert joints == noisy.encoders()[:6]
        assert noisy._motors_at(noisy.time_s)[:6] == true
        reads.append(np.subtract(joints, true))
    assert np.std(reads) == pytest.approx(1e-4, rel=0.1)


def test_a_moving_tool_feels_its_own_inertia() -> None:
    world = World(Scenario(seed=1, force_torque=ForceTorque(sigma_translation=0, sigma_rotation=0)))
    start = world.scenario.robot.start
    for k in range(100):
        world.advance(world.cycle_start(k))
        world.command((*start[:6], 0.5 * (0.012 * k) ** 2))
    deflection = world.deflection()
    # 1 m/s^2 along y bends the mount backwards by a / w^2 on average.
    bends = []
    for k in range(100, 300):
        world.advance(world.cycle_start(k))
        world.command((*start[:6], 0.5 * (0.012 * k) ** 2))
        bends.append(world.deflection()[1])
    expected = -1.0 / (math.tau * 4.5) ** 2
    assert np.mean(bends) == pytest.approx(expected, rel=0.1)
    assert deflection[0] == pytest.approx(0.0, abs=1e-9)
    wrench = world.take_wrench()[-1]
    assert wrench.force[1] == pytest.approx(50e3 * world.deflection()[1], rel=0.2)


QUIET = Scenario(
    seed=0,
    conveyor=Conveyor(
        events=(ConveyorEvent("stop", 4.0, 0.104), ConveyorEvent("start", 7.0, 0.05)),
        ripple=Ripple(speed_sigma=0.0, amplitude=0.0),
    ),
    body=Body(offset=(0, 0, 0), rotation=(0, 0, 0), swings=(Swing(amplitude=0.0, phase=0.0),)),
)


def inverse(world: World, goal: np.ndarray, seed: tuple[float, ...]) -> tuple[float, ...]:
    """Newton's method on the world's own kinematics, E1 given."""
    q = list(seed)
    for _ in range(20):
        here = rotation.matrix(world._arm.tcp(tuple(q)))
        error = np.concatenate([goal[:3, 3] - here[:3, 3], _turn(here, goal)])
        if np.abs(error).max() < 1e-12:
            break
        columns = []
        for i in range(6):
            moved = rotation.matrix(
                world._arm.tcp(tuple(v + 1e-6 * (j == i) for j, v in enumerate(q)))
            )
            columns.append(np.concatenate([moved[:3, 3] - here[:3, 3], _turn(here, moved)]) / 1e-6)
        q[:6] = (np.array(q[:6]) + np.linalg.solve(np.array(columns).T, error)).tolist()
    return tuple(q)


def _turn(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    turned = there[:3, :3] @ here[:3, :3].T
    return 0.5 * np.array(
        (turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1])
    )


def gap_at(t: float) -> float:
    """Programmed distance to the hub: in by 2 s, out from 9 s."""
    if t < 9.0:
        return 0.15 * max(0.0, 1.0 - t / 2.0) ** 2 - 0.0005 * (t >= 1.9)
    return min(0.15, 0.05 * (t - 9.0) ** 2)


YIELDING = CarrierMode(frequency_hz=1.2, damping=0.03, mass=800.0)


@pytest.mark.parametrize("carrier", [(), (YIELDING,)])
def test_an_oracle_robot_mates_the_wheel_through_a_stop_and_a_restart(
    carrier: tuple[CarrierMode, ...],
) -> None:
    """A robot that knows the future and lags by a known ramp delay: the whole sequence runs."""
    axes = tuple(Axis(8.0, 0.8, 0.024, 50.0) for _ in range(7))
    lag = 0.024 + 0.012 + 2 * 0.8 / (math.tau * 8.0)
    robot = Robot(axes=axes, start=(*Robot().start[:6], 0.106 * (lag - 2.0)))  # type: ignore[arg-type]
    effector = Effector(damping=(0.2,) * 6)
    force_torque = ForceTorque(period_s=0.0017, sigma_translation=0.0, sigma_rotation=0.0)
    body = replace(QUIET.body, carrier=carrier)
    world = World(
        replace(QUIET, robot=robot, effector=effector, force_torque=force_torque, body=body)
    )
    q: tuple[float, ...] = world.scenario.robot.start
    phases, worst = [], 0.0
    for k in range(int(13.0 / 0.012)):
        t = world.cycle_start(k)
        world.advance(t)
        phases.append(world.contact)
        goal = world.hub_pose(t + lag)
        share = min(max((t + 2.0) / 1.5, 0.0), 1.0)
        goal[:3, 3] -= gap_at(t + lag) * goal[:3, 2]
        goal[2, 3] += 0.269 * (1 - share) ** 2
        goal[0, 3] -= 0.15 * (1 - share) ** 2
        q = inverse(world, goal, (*q[:6], world.unit_position(t + lag)))
        world.command(q)
        world.digital_out((1 if t > 5.0 else 0) | (2 if t > 8.0 else 0))
        if world.contact == "clamped" and t > 2.5:
            worst = max(worst, float(np.linalg.norm(world.deflection()[:3])))
            assert world.tcp_pose() == pytest.approx(world.hub_pose(), abs=1e-12)
            bent = world.tcp_rigid_pose()[:3, :3] @ world.deflection()[:3]
            assert world.tcp_rigid_pose()[:3, 3] + bent == pytest.approx(world.hub_pose()[:3, 3])
            felt = world.take_wrench()[-1].force
            assert felt == pytest.approx(50e3 * np.array(world.deflection()[:3]), abs=5.0)
        if world.collision is not None:
            break
    assert world.collision is None
    assert list(dict.fromkeys(phases)) == ["free", "clamped", "released"]
    assert world.impact is not None
    assert math.hypot(*world.impact.position[:2]) < 0.001
    assert worst < 0.0025
    assert world.digital_in() == 3
    assert world.screws_fixed_s == pytest.approx(5.0 + 1.05, abs=0.02)
    assert world.released_s == pytest.approx(8.3, abs=0.02)


def test_a_robot_that_stands_in_the_way_is_hit() -> None:
    """No controller: the tool waits inside the hub's plane until the hub comes along."""
    world = World(replace(QUIET, lead_in_s=7.0))
    goal = world.hub_pose(0.0)
    goal[:3, 3] += 0.05 * goal[:3, 2]
    q = inverse(world, goal, world.scenario.robot.start)
    world = World(replace(QUIET, lead_in_s=7.0, robot=Robot(start=q)))  # type: ignore[arg-type]
    world.advance(0.0)
    assert world.collision is not None
    assert world.collision.reason.startswith("hit the hub from the side")
    assert world.collision.time_s == pytest.approx(-0.5 / 0.106, abs=0.05)


def test_a_world_past_its_duration_goes_on() -> None:
    world = World(Scenario(duration_s=1.0))
    world.advance(3.0)
    assert world.time_s == 3.0
    assert world.hub_pose().shape == (4, 4)


def test_an_open_scenario_is_sampled_by_its_own_seed() -> None:
    assert World(Scenario(seed=9)).scenario == sample(9)


def test_an_arm_that_bends_is_unseen_by_its_encoders() -> None:
    """Encoders are on the motor side; the rigid tcp comes from the link side."""
    robot = replace(Robot(), effects=ArmEffects(windup=WindupEffect((0.6e-3,) * 6)))
    bent, straight = World(Scenario(robot=robot)), World(Scenario())
    for k in range(200):
        for world in (bent, straight):
            world.advance(world.cycle_start(k))
            world.command(tuple(q + 1e-4 * k for q in world.scenario.robot.start))
    assert bent.encoders() == straight.encoders()
    assert bent.reported() == straight.rigid()
    off = np.linalg.norm(bent.tcp_rigid_pose()[:3, 3] - straight.tcp_rigid_pose()[:3, 3])
    assert 0.5e-3 < off < 4e-3


def test_encoders_are_read_in_steps() -> None:
    steps = (1e-4,) * 7
    robot = replace(Robot(), effects=ArmEffects(quantisation=steps))
    world = World(Scenario(robot=robot))
    world.command(tuple(q + 1e-3 for q in robot.start))
    world.advance(world.time_s + 0.1)
    true = world._motors_at(world.time_s)[:6]
    counts = np.divide(world.encoders(), 1e-4)
    assert counts == pytest.approx(np.round(counts), abs=1e-6)
    assert np.abs(np.subtract(world.encoders()[:6], true)).max() <= 0.5e-4
    assert world.encoders()[:6] != true
