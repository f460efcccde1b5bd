"""Oracles that judge by the plant: each blames what it is for, and nothing without a cause."""

from dataclasses import replace
from typing import Any

import pytest

from linemate.daemon.cycle.states import State
from linemate.simulators.devices.limit_judge import LIMITS, LimitJudge
from linemate.simulators.lab.faults import dst_plant_oracles as oracles
from linemate.simulators.lab.faults.dst_plant_oracles import PlantOracle, Seen
from linemate.simulators.plants.contact_plant import Collision
from linemate.simulators.plants.scenario import Robot, Scenario
from linemate.simulators.plants.servo_plant import ServoBank

T0 = 0.012
TURN = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
STILL = (0.0,) * 7


class Plant:
    """A plant of which each test says what it is."""

    def __init__(self) -> None:
        self.scenario = Scenario()
        self.tool = (0.0, 0.0, -0.1)
        self.place = (0.0, 0.0, 0.0)
        self.bent = (0.0,) * 6
        self.contact = "free"
        self.collision: Collision | None = None
        self.speed = 0.106
        self.velocities: tuple[float, ...] = STILL
        self.rail = 0.0

    def rigid(self) -> Any:
        return (self.tool, TURN)

    def hub(self) -> Any:
        return (self.place, TURN)

    def deflection(self) -> tuple[float, ...]:
        return self.bent

    def unit_speed(self) -> float:
        return self.speed

    def unit_position(self) -> float:
        return 0.0

    def encoders(self) -> tuple[float, ...]:
        return (*STILL[:6], self.rail)


class Sensors:
    """Links of which each test says when they were heard last."""

    def __init__(self) -> None:
        self.has_wrench, self.wrench_n = True, 0.0
        self.now_s = 0.0
        self.silent: dict[str, float] = {}
        self.frozen: dict[str, float] = {}
        self.wrong: dict[str, float] = {}

    def heard_s(self, name: str) -> float:
        return self.silent.get(name, self.now_s)

    true_s = heard_s

    def moved_s(self, name: str) -> float:
        return self.frozen.get(name, self.heard_s(name))

    def wrong_s(self, name: str) -> float:
        return self.wrong.get(name, float("-inf"))


class Run:
    """An oracle, its plant, and a daemon that is in one state."""

    def __init__(self, state: State = State.TRACK, **options: Any) -> None:
        self.plant, self.sensors = Plant(), Sensors()
        self.found: list[str] = []
        plant: Any = self.plant
        sensors: Any = self.sensors
        self.oracle = PlantOracle(plant, sensors, T0, self.found.append, **options)
        self.seen = Seen(0.0, state, "", True, True, float("-inf"), STILL, None, False, False)
        if state is State.CONTACT:
            self.plant.contact, self.plant.tool = "clamped", self.plant.place

    def go(self, seconds: float, **changes: Any) -> list[str]:
        """Let some time pass."""
        self.seen = replace(self.seen, **changes)
        for _ in range(round(seconds / T0)):
            self.seen = replace(self.seen, now_s=self.seen.now_s + T0)
            self.sensors.now_s = self.seen.now_s
            x, y, z = self.plant.place
            self.plant.place = (x, y + self.plant.speed * T0, z)
            a, b, c = self.plant.tool
            self.plant.tool = (a, b + self.plant.speed * T0, c)
            self.oracle.judge_cycle(self.seen)
        return [what.partition(":")[0] for what in self.found]


def test_a_tool_that_follows_its_hub_and_sensors_that_are_heard_are_not_blamed() -> None:
    run = Run()
    assert run.go(2.0) == []
    run.plant.contact, run.plant.tool = "clamped", run.plant.place
    assert run.go(2.0, state=State.CONTACT) == []
    assert run.oracle.excused == []


def test_a_collision_is_blamed_once_with_its_figures_and_the_state() -> None:
    run = Run()
    run.plant.collision = Collision(0.5, "missed the hub: 9.0 mm")
    assert run.go(0.5) == ["collision"]
    assert run.found == ["collision: missed the hub: 9.0 mm, in TRACK"]


@pytest.mark.parametrize(("mm", "kinds"), [(3.9, []), (4.1, ["force"])])
def test_a_clamped_tool_with_more_than_200_n_is_blamed(mm: float, kinds: list[str]) -> None:
    run = Run(State.RETREAT)
    run.plant.contact, run.plant.bent = "clamped", (1e-3 * mm, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.1) == kinds


def test_a_tool_that_rings_in_the_air_has_no_force() -> None:
    run = Run()
    run.plant.bent = (0.006, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.1) == []


@pytest.mark.parametrize(
    ("before_mm", "mm", "kinds"), [(2.0, 5.9, []), (2.0, 6.1, ["swing"]), (4.1, 6.1, [])]
)
def test_a_retreat_that_makes_a_free_tool_swing_is_blamed(
    before_mm: float, mm: float, kinds: list[str]
) -> None:
    run = Run(State.RETREAT)
    run.plant.bent = (1e-3 * before_mm, 0.0, 0.0, 0.0, 0.0, 0.0)
    run.go(0.4)
    run.plant.bent = (1e-3 * mm, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.1) == kinds


def test_a_swing_of_lost_replies_is_not_the_retreats() -> None:
    run = Run(State.RETREAT)
    run.go(0.4)
    run.plant.bent = (0.0061, 0.0, 0.0, 0.0, 0.0, 0.0)
    run.go(0.1, answered=False)
    assert run.go(0.5, answered=True) == []


def test_a_force_of_a_plan_that_took_the_commands_away_at_the_hub_is_excused() -> None:
    run = Run(State.CONTACT)
    run.go(0.1)
    run.go(0.1, answered=False)
    run.plant.bent = (0.006, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.05) == []
    assert run.oracle.excused[0].endswith("commands lost since 0.108 s")


@pytest.mark.parametrize(("readable", "kinds"), [(False, []), (True, ["force"])])
def test_bare_replies_are_a_loss_of_commands_only_to_telegrams_that_cannot_be_read(
    readable: bool, kinds: list[str]
) -> None:
    run = Run(State.CONTACT)
    run.go(0.1)
    run.go(0.1, readable=readable)
    run.plant.bent = (0.006, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.05) == kinds


def test_telegrams_that_cannot_be_read_excuse_no_robot_that_was_moved() -> None:
    run = Run(State.CONTACT)
    run.go(0.1)
    for cycle in range(8):
        run.go(T0, readable=False, sent=tuple(0.001 * cycle for _ in STILL))
    run.plant.bent = (0.006, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.05, readable=True) == ["force"]


@pytest.mark.parametrize(("mm", "kinds"), [(4.0, []), (30.0, ["collision"])])
def test_a_daemon_that_died_at_the_hub_may_not_move_a_robot_that_the_hub_runs_into(
    mm: float, kinds: list[str]
) -> None:
    run = Run()
    run.plant.tool = (0.0, 0.0, -1e-3 * mm)
    run.go(0.1)
    run.go(0.2, state=None)
    run.go(0.3, state=State.INIT)
    run.plant.collision = Collision(0.6, "missed the hub: 62.0 mm")
    assert run.go(0.02) == kinds


def test_a_force_long_after_the_commands_came_back_is_not_excused() -> None:
    run = Run(State.CONTACT)
    run.go(0.1)
    run.go(0.15, answered=False, state=State.FAULT)
    run.go(0.3, answered=True)
    run.plant.bent = (0.006, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert run.go(0.05) == ["force"]


def test_a_collision_with_a_line_that_stands_is_no_one_elses_fault() -> None:
    run = Run(State.CONTACT)
    run.plant.contact, run.plant.tool, run.plant.speed = "clamped", run.plant.place, 0.0
    run.go(0.1)
    run.plant.collision = Collision(0.3, "mount overloaded")
    assert run.go(0.5, answered=False)[0] == "collision"


def test_a_daemon_that_moves_a_clamped_robot_after_its_restart_is_not_excused() -> None:
    run = Run(State.CONTACT)
    run.plant.contact, run.plant.tool = "clamped", run.plant.place
    run.go(0.1)
    run.go(0.06, state=None, answered=False)
    run.go(0.2, state=State.INIT, answered=True)
    run.seen = replace(run.seen, sent=(0.04, *STILL[1:]))
    run.plant.collision = Collision(0.3, "mount overloaded")
    assert run.go(0.02) == ["collision"]
    assert run.oracle.excused == []


@pytest.mark.parametrize(
    ("mm_off_axis", "mm_before", "state", "kinds"),
    [
        (7.0, 5.0, State.TRACK, ["place"]),
        (7.0, 5.0, State.RETREAT, []),
        (7.0, 30.0, State.TRACK, []),
        (5.0, 5.0, State.TRACK, []),
    ],
)
def test_a_tool_at_the_hub_and_off_its_axis_is_blamed_while_it_tracks(
    mm_off_axis: float, mm_before: float, state: State, kinds: list[str]
) -> None:
    run = Run(state)
    run.plant.tool = (1e-3 * mm_off_axis, 0.0, -1e-3 * mm_before)
    assert run.go(0.2) == kinds


@pytest.mark.parametrize(("contact", "kinds"), [("free", ["screws"]), ("clamped", [])])
def test_screws_that_are_ordered_in_the_air_are_blamed(contact: str, kinds: list[str]) -> None:
    run = Run(State.RETREAT)
    run.plant.contact = contact
    assert run.go(0.3, screws=True) == kinds


@pytest.mark.parametrize(("metres", "kinds"), [(0.09, []), (0.11, ["rail"])])
def test_a_rail_that_leaves_its_object_is_blamed(metres: float, kinds: list[str]) -> None:
    run = Run()
    run.plant.tool = (0.0, 0.0, -0.05)
    run.go(0.1)
    run.plant.rail = metres
    assert run.go(0.1) == kinds


@pytest.mark.parametrize(
    ("silent", "state", "bearable_s", "too_long_s"),
    [
        (("distance", "camera"), State.TRACK, 0.3, 0.4),
        (("distance", "camera"), State.CONTACT, 0.16, 0.26),
        (("force_torque",), State.TRACK, 0.16, 0.26),
        (("force_torque",), State.CONTACT, 0.16, 0.26),
    ],
)
def test_a_silence_that_ends_no_motion_is_blamed(
    silent: tuple[str, ...], state: State, bearable_s: float, too_long_s: float
) -> None:
    run = Run(state)
    run.go(1.0)
    run.sensors.silent = dict.fromkeys(silent, run.seen.now_s)
    assert run.go(bearable_s) == []
    assert run.go(too_long_s - bearable_s) == ["reaction"]


def test_a_contact_that_is_felt_late_in_a_silence_is_granted_its_reaction() -> None:
    run = Run()
    run.go(1.0)
    run.sensors.silent = dict.fromkeys(("distance", "camera"), run.seen.now_s)
    assert run.go(0.28) == []
    # CONTACT bears a shorter silence than TRACK.
    run.plant.contact, run.plant.tool = "clamped", run.plant.place
    assert run.go(0.06, state=State.CONTACT) == []
    assert run.go(0.03) == ["reaction"]


def test_a_silence_is_not_blamed_in_a_state_that_ended_the_motion() -> None:
    run = Run(State.HOLD)
    run.sensors.silent = {"distance": 0.0, "camera": 0.0, "force_torque": 0.0}
    assert run.go(2.0) == []


def test_a_cell_without_a_force_sensor_misses_no_wrench() -> None:
    run = Run()
    run.sensors.has_wrench, run.sensors.silent = False, {"force_torque": 0.0}
    assert run.go(2.0) == []


def test_a_frozen_wrench_that_ends_no_motion_is_blamed() -> None:
    run = Run(State.CONTACT)
    run.go(0.5)
    run.sensors.frozen = {"force_torque": run.seen.now_s}
    assert run.go(0.4) == []
    assert run.go(0.1) == ["reaction"]


def test_a_sensor_that_says_500_n_ends_the_motion() -> None:
    run = Run(State.CONTACT)
    run.sensors.wrench_n = 500.0
    assert run.go(0.1) == ["reaction"]


@pytest.mark.parametrize("has_wrench", [True, False])
def test_a_clamped_tool_that_no_one_noticed_is_blamed(has_wrench: bool) -> None:
    run = Run()
    run.plant.contact, run.plant.tool = "clamped", run.plant.place
    run.sensors.has_wrench = has_wrench
    assert run.go(0.3) == []
    assert run.go(0.2) == ["reaction"]


@pytest.mark.parametrize(
    ("state", "bearable_s", "too_long_s"), [(State.TRACK, 0.24, 0.3), (State.CONTACT, 0.43, 0.5)]
)
def test_replies_that_move_nothing_end_the_motion(
    state: State, bearable_s: float, too_long_s: float
) -> None:
    run = Run(state)
    run.go(0.5)
    assert run.go(bearable_s, answered=False) == []
    assert run.go(too_long_s - bearable_s) == ["reaction"]


def test_what_a_controller_was_sent_while_its_drives_were_off_did_not_move_the_robot() -> None:
    run = Run(State.CONTACT)
    run.go(0.1)
    run.go(0.1, programme=False, stands=STILL)
    run.go(0.05, sent=(0.005, *STILL[1:]))
    run.plant.collision = Collision(0.3, "mount overloaded")
    assert run.go(0.02) == []
    assert "programme lost" in run.oracle.excused[0]


def test_a_process_that_had_no_processor_is_granted_its_reaction() -> None:
    run = Run()
    run.go(0.5)
    run.go(0.5, answered=False, busy_s=0.9)
    assert run.go(0.1, busy_s=1.0) == []


def test_an_overload_while_the_daemon_has_no_processor_is_granted_its_reaction() -> None:
    run = Run(State.CONTACT)
    run.sensors.wrench_n = 500.0
    assert run.go(0.2, busy_s=0.2) == []
    assert run.go(0.1) == ["reaction"]


def test_axes_that_are_braked_and_sent_away_end_the_motion() -> None:
    run = Run()
    assert run.go(0.4, stands=STILL, sent=(0.02, *STILL[1:])) == []
    assert run.go(0.1) == ["reaction"]


@pytest.mark.parametrize(("mm", "kinds"), [(5.0, []), (12.0, ["phantom"])])
def test_a_contact_far_from_the_hub_is_blamed(mm: float, kinds: list[str]) -> None:
    run = Run()
    run.plant.tool = (0.0, 0.0, -1e-3 * mm)
    run.go(0.1)
    assert run.go(0.1, state=State.CONTACT) == kinds


def test_an_overload_that_no_one_bore_is_blamed_unless_a_wrench_was_wrong() -> None:
    run = Run()
    run.go(0.5)
    run.sensors.wrong = {"force_torque": run.seen.now_s}
    assert run.go(0.1, state=State.RETREAT, because="overload") == []
    run = Run()
    run.go(0.5)
    assert run.go(0.1, state=State.RETREAT, because="overload") == ["phantom"]


def test_readable_telegrams_without_an_answer_are_blamed() -> None:
    run = Run(State.IDLE)
    run.go(0.1, is_heard=True)
    assert run.go(0.1, answered=False) == []
    assert run.go(0.1) == ["answer"]
    run = Run(State.IDLE)
    assert run.go(0.5, answered=False) == []


@pytest.mark.parametrize(("off", "kinds"), [(0.05, []), (0.07, ["cycle"]), (-0.07, ["cycle"])])
def test_tracking_for_a_controller_of_another_cycle_is_blamed(off: float, kinds: list[str]) -> None:
    assert Run(cycle_off=off).go(0.1) == kinds


# Jerk.


def shaken(cycles: int) -> list[tuple[float, ...]]:
    """Setpoints of A1 that change from +40 to -40 rad/s^2 every so many cycles, at 12 ms."""
    positions, x, v = [], 0.0, 0.0
    for k in range(120):
        v += (40.0 if (k // cycles) % 2 == 0 else -40.0) * T0
        x += v * T0
        positions.append((x, *STILL[1:]))
    return positions


def test_setpoints_within_all_limits_can_fail_by_the_jerk_of_the_servo_at_12_ms() -> None:
    setpoints = shaken(4)
    judge = LimitJudge(T0, tuple(replace(one, acceleration=40.5) for one in LIMITS))
    judge.start(STILL)
    for point in setpoints:
        judge.judge(point)
    assert judge.counts["jerk"] == 0  # 2 A / T = 6667 is below the limit of 25 000

    robot = Robot(start=STILL)  # type: ignore[arg-type]
    bank = ServoBank(robot.axes, STILL, T0, 3)
    run = Run()
    for cycle, point in enumerate(setpoints):
        bank.begin_cycle(cycle)
        bank.command(cycle, 0.0, point)
        for part in range(3):
            bank.advance(3 * cycle + part)
        run.plant.velocities = bank.velocities
        run.go(T0)
    assert run.found[0].startswith("jerk: ")
    assert "axis 0's servo" in run.found[0]


def test_a_smooth_motion_and_what_the_controller_did_by_itself_are_not_blamed() -> None:
    run = Run()
    for k in range(60):
        run.plant.velocities = (0.01 * k, *STILL[1:])
        run.go(T0)
    assert run.found == []
    run.plant.velocities = STILL
    run.go(T0, answered=False)
    assert run.go(0.2, answered=True) == []


def test_the_bound_of_the_jerk_is_each_axis_own() -> None:
    axes = Robot().axes
    assert [round(axis.acceleration_limit / oracles.BUILD_UP_S) for axis in axes] == [
        400, 500, 600, 1000, 1200, 1500, 200,
    ]  # fmt: skip
