"""Rows of the fault catalogue in virtual time, each with its figure; see docs/reliability.md.

The whole daemon lives through a short assembly (contact at 1.1 s, retreat at 1.9 s); what a fault
adds is compared with the same run without it. All oracles of the campaign judge each run.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from linemate.daemon.cycle.states import State
from linemate.simulators.lab.faults.dst_actors import SHORTEST_PAUSE_S
from linemate.simulators.lab.faults.dst_plan import CycleMs, FaultPlan
from linemate.simulators.lab.faults.dst_run import Simulation
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Fault

pytestmark = pytest.mark.row

Within = Callable[[str, float, float], None]

SENSORS = ("distance", "camera", "force_torque")
ALWAYS = -0.95, 4.55
CYCLE_S = FaultPlan(0).cycle_s
IN_CONTACT_S = 1.25
SETTLED_S = 1.13
"""The impact itself is not compared: a cycle sooner or later it is another one."""

BEGUN_S = -2.2
FREE_S = -0.05
"""As the task begins, and before the last approach: scenario time [s]."""


@dataclass(frozen=True)
class Row:
    """One cycle as the plant knows it."""

    state: str
    error_mm: float
    """Rigid tcp against the true hub."""
    clamped: bool
    tool: tuple[float, ...]
    setpoints: tuple[float, ...]
    predicted_mm: float
    """The daemon's idea of the hub against the true one, along the conveyor."""


class Lived(Simulation):
    """A run that keeps what the plant knows of each cycle."""

    def __init__(self, plan: FaultPlan) -> None:
        super().__init__(plan)
        self.rows: dict[float, Row] = {}
        self.homed_s = float("inf")
        self.missed = 0
        """Telegrams without an answer in time, until the controller's programme drives home."""

    def _judge_cycle(self) -> None:
        super()._judge_cycle()
        if self.robot.is_paused:
            self.homed_s = min(self.homed_s, self.now_s)
        if self.now_s < self.homed_s:
            self.missed = self.controller.counts.lost + self.controller.counts.late
        if self.app is None:
            return
        world, cycle = self.world, self.app.cycle
        tcp, hub = world.tcp_rigid_pose()[:3, 3], world.hub_pose()[:3, 3]
        part = None if cycle.last is None else cycle.last.outputs.part
        self.rows[round(self.now_s, 3)] = Row(
            cycle.machine.state.value,
            float(np.linalg.norm(tcp - hub)) * 1e3,
            world.contact == "clamped",
            tuple(tcp.tolist()),
            self.controller.setpoints,
            float("nan") if part is None else (part[1] - float(hub[1])) * 1e3,
        )

    def states(self, until_s: float = 2.6) -> list[str]:
        """The operating states in their order."""
        seen: list[str] = []
        for at_s, row in self.rows.items():
            if at_s < until_s and (not seen or seen[-1] != row.state):
                seen.append(row.state)
        return seen

    def entered(self, state: State, since_s: float) -> float:
        """When a state was entered, in scenario time [s]."""
        return next(at for at, row in self.rows.items() if at > since_s and row.state == state)

    def speed(self, at_s: float) -> float:
        """Of the tool in base [m/s]."""
        times = sorted(self.rows)
        n = min(range(len(times)), key=lambda n: abs(times[n] - at_s))
        a, b = self.rows[times[n - 1]], self.rows[times[n]]
        return float(np.linalg.norm(np.subtract(b.tool, a.tool))) / (times[n] - times[n - 1])


def live(
    *faults: Fault,
    stop_s: float | None = None,
    seed: int = 0,
    may_touch: bool = False,
    duration_s: float = 2.6,
) -> Lived:
    events = () if stop_s is None else (ConveyorEvent("stop", stop_s, 0.104),)
    lived = Lived(FaultPlan(seed, duration_s=duration_s, events=events, faults=faults))
    lived.live()
    assert lived.outcome().violations == ()
    # Driving the robot home without the daemon is not judged.
    touched = lived.world.collision
    assert may_touch or touched is None or touched.time_s > lived.homed_s
    return lived


@cache
def undisturbed(stop_s: float | None = None, seed: int = 0) -> Lived:
    return live(stop_s=stop_s, seed=seed)


ADDED = "added to the error, cycle by cycle, mm"
ASSEMBLED = ["init", "idle", "armed", "track", "contact", "retreat"]


def added(lived: Lived, reference: Lived, since_s: float = SETTLED_S) -> float:
    """The most that a fault added to the error while the wheel was on the hub [mm]."""
    return max(
        row.error_mm - reference.rows[at].error_mm
        for at, row in lived.rows.items()
        if at >= since_s and row.clamped and at in reference.rows and reference.rows[at].clamped
    )


def greatest(lived: Lived) -> float:
    """The most that the tool was off after the conveyor began to stop [mm]."""
    return max(
        row.error_mm
        for at, row in lived.rows.items()
        if IN_CONTACT_S <= at <= IN_CONTACT_S + 0.5 and row.clamped
    )


def every(kind: str, value: float, links: tuple[str, ...] = SENSORS) -> tuple[Fault, ...]:
    return tuple(Fault(ALWAYS[0], link, kind, ALWAYS[1], value) for link in links)


def blackout(at_s: float, lasting_s: float, links: tuple[str, ...] = SENSORS) -> tuple[Fault, ...]:
    return tuple(Fault(at_s, link, "silence", lasting_s) for link in links)


# S: the sensors' links.


@pytest.mark.parametrize(("share", "most_mm"), [(0.01, 1.0), (0.05, 1.0), (0.2, 2.0)])
def test_s1_loss_on_every_sensor_changes_no_state_and_little_else(
    share: float, most_mm: float, within: Within
) -> None:
    lived = live(*every("loss", share))
    assert lived.states() == ASSEMBLED
    within(ADDED, added(lived, undisturbed()), most_mm)


@pytest.mark.parametrize("lasting_s", [0.04, 0.1, 0.14])
def test_s2_a_blackout_up_to_140_ms_in_contact_is_coasted_though_the_conveyor_brakes_as_it_begins(
    lasting_s: float, within: Within
) -> None:
    for seed in (0, 1, 2):
        reference = undisturbed(IN_CONTACT_S, seed)
        lived = live(*blackout(IN_CONTACT_S, lasting_s), stop_s=IN_CONTACT_S, seed=seed)
        assert lived.states() == ASSEMBLED
        over_s = round(IN_CONTACT_S + lasting_s, 3)
        blind = [at for at in lived.rows if IN_CONTACT_S < at <= over_s]
        tool = max(lived.rows[at].error_mm - reference.rows[at].error_mm for at in blind)
        known = max(
            abs(lived.rows[at].predicted_mm) - abs(reference.rows[at].predicted_mm) for at in blind
        )
        within("added while it lasts: tool to hub, mm", tool, 1.1)
        within("added while it lasts: hub as predicted, mm", known, 1.1)
        # The news of the stop reach the tool later still, by the robot's own delay. The greatest
        # error grows by less than what is lost cycle by cycle on a run that has recovered already.
        within("added to the greatest error, mm", greatest(lived) - greatest(reference), 1.5)
        within(ADDED, added(lived, reference, IN_CONTACT_S), 1.8)


def test_s2_a_blackout_in_free_space_holds_within_304_ms_and_the_tool_is_soon_at_rest(
    within: Within,
) -> None:
    lived = live(*blackout(FREE_S, 1.0))
    held_s = lived.entered(State.HOLD, FREE_S)
    within("to the hold, s", held_s - FREE_S, 0.304)
    # The axes' own delay comes on top of the ramp.
    within("speed 0.3 s later, m/s", lived.speed(held_s + 0.3), 0.02)


def test_s2_an_object_that_is_unseen_ends_the_approach_within_304_ms_and_a_cycle(
    within: Within,
) -> None:
    # The tool waits at its last waypoint before contact for a pose, and is held there.
    lived = live(*blackout(FREE_S, 1.0, ("distance", "camera")))
    within("to the hold, s", lived.entered(State.HOLD, FREE_S) - FREE_S, 0.304 + 2 * CYCLE_S)


def test_s2_a_longer_blackout_in_contact_is_a_retreat_within_its_coasting_and_a_cycle(
    within: Within,
) -> None:
    lived = live(*blackout(IN_CONTACT_S, 0.3))
    retreat_s = lived.entered(State.RETREAT, IN_CONTACT_S) - IN_CONTACT_S
    within("to the retreat, s", retreat_s, 0.16 + 2 * CYCLE_S)


@pytest.mark.parametrize(
    ("kind", "value", "links"), [("delay", 0.1, ("camera",)), ("jitter", 0.005, SENSORS)]
)
def test_s3_a_delay_that_is_stamped_and_jitter_cost_little(
    kind: str, value: float, links: tuple[str, ...], within: Within
) -> None:
    lived = live(*every(kind, value, links))
    assert lived.states() == ASSEMBLED
    within(ADDED, added(lived, undisturbed()), 2.0)


def test_s4_duplicates_change_not_one_bit_of_what_is_commanded() -> None:
    lived = live(*every("duplicate", 1.0, ("camera",)))
    reference = undisturbed()
    same = [at for at in lived.rows if at in reference.rows and at < 2.6]
    assert len(same) > 200
    assert all(lived.rows[at].setpoints == reference.rows[at].setpoints for at in same)


@pytest.mark.parametrize("kind", ["flip", "truncate", "reorder", "nan"])
def test_s5_s8_damage_on_the_way_is_refused_and_changes_no_state(kind: str, within: Within) -> None:
    from linemate.simulators.devices.faults import KINDS

    links = tuple(link for link in SENSORS if kind in KINDS[link])
    lived = live(*every(kind, 0.1, links))
    assert lived.states() == ASSEMBLED
    within(ADDED, added(lived, undisturbed()), 1.0)


def test_s6_a_stuck_distance_is_out_within_170_ms_and_the_tool_does_not_touch() -> None:
    lived = live(Fault(FREE_S, "distance", "stuck", 2.0))
    states = lived.states()
    assert "contact" not in states
    assert states[4:5] in (["hold"], ["retreat"])


def test_s6_a_stuck_force_in_contact_is_a_retreat(within: Within) -> None:
    lived = live(Fault(IN_CONTACT_S, "force_torque", "stuck", 2.0))
    retreat_s = lived.entered(State.RETREAT, IN_CONTACT_S) - IN_CONTACT_S
    within("to the retreat, s", retreat_s, 0.16 + 3 * CYCLE_S)
    within(ADDED, added(lived, undisturbed(), IN_CONTACT_S), 1.0)


def test_s6_a_stuck_camera_is_done_without(within: Within) -> None:
    lived = live(Fault(FREE_S, "camera", "stuck", 2.0))
    if "contact" in lived.states():
        within(ADDED, added(lived, undisturbed()), 2.0)


@pytest.mark.parametrize(
    ("link", "kind", "value"),
    [
        ("distance", "scale", 1000.0),
        ("distance", "scale", -1.0),
        ("camera", "scale", 1e-3),
        ("camera", "offset", 0.02),
        ("force_torque", "scale", 1000.0),
    ],
)
def test_s7_a_wrong_unit_sign_or_offset_ends_in_a_hold_or_a_retreat(
    link: str, kind: str, value: float
) -> None:
    lived = live(Fault(FREE_S, link, kind, 2.0, value, 0))
    after = lived.states()[4:]
    assert {"hold", "retreat"} & set(after)


def test_s7_a_step_of_the_distance_is_outvoted_by_what_the_camera_sees(within: Within) -> None:
    lived = live(Fault(BEGUN_S, "distance", "offset", 6.0, 0.02))
    assert lived.states() == ASSEMBLED
    within(ADDED, added(lived, undisturbed()), 1.0)


def test_s7_a_step_of_the_distance_shortly_before_the_last_approach_makes_the_tool_wait(
    within: Within,
) -> None:
    # Predictions made just before it are 20 mm off: it goes on once they are right again.
    lived = live(Fault(FREE_S, "distance", "offset", 6.0, 0.02), duration_s=5.0)
    assert lived.states(until_s=5.0)[:6] == ASSEMBLED
    clamped = [row.error_mm for row in lived.rows.values() if row.clamped]
    reference = [row.error_mm for row in undisturbed().rows.values() if row.clamped]
    within("added to the greatest error, mm", max(clamped) - max(reference), 1.0)


@pytest.mark.parametrize("value", [3600.0, -3600.0])
@pytest.mark.parametrize("link", ["camera", "force_torque"])
def test_s9_a_sensors_clock_that_steps_by_an_hour_changes_no_state(
    link: str, value: float, within: Within
) -> None:
    lived = live(Fault(FREE_S, link, "clock_step", 2.0, value))
    assert lived.states() == ASSEMBLED
    within(ADDED, added(lived, undisturbed()), 1.0)


@pytest.mark.parametrize("value", [-0.015, -0.025, -0.035])
def test_s9_a_force_sensors_clock_that_is_set_back_a_little_in_contact_costs_nothing(
    value: float, within: Within
) -> None:
    lived = live(Fault(IN_CONTACT_S, "force_torque", "clock_step", 2.0, value))
    assert lived.states() == ASSEMBLED
    within(ADDED, added(lived, undisturbed()), 1.0)


def test_s10_a_burst_of_200_pieces_on_every_sensor_costs_no_telegram() -> None:
    lived = live(*(Fault(FREE_S, link, "garbage", 0.1, 0.0, 200) for link in SENSORS))
    assert lived.states() == ASSEMBLED
    assert lived.controller.counts.lost == lived.controller.counts.late == 0


def test_s11_a_port_that_is_gone_is_opened_again_without_a_missed_telegram() -> None:
    lived = live(Fault(FREE_S, "distance", "unplug", 0.3))
    assert lived.states() == ASSEMBLED
    assert lived.controller.counts.lost == lived.controller.counts.late == 0


def test_s12_a_force_beyond_bearing_is_a_retreat_within_a_cycle_of_its_second_sample(
    within: Within,
) -> None:
    lived = live(Fault(FREE_S, "force_torque", "offset", 0.2, 2000.0, 0))
    # Two samples at 250 Hz, and the telegram after them.
    retreat_s = lived.entered(State.RETREAT, FREE_S) - FREE_S
    within("to the retreat, s", retreat_s, 0.008 + 2 * CYCLE_S)


# R: the robot's link.


@pytest.mark.parametrize("link", ["robot", "reply"])
def test_r1_telegrams_lost_now_and_then_change_no_state(link: str, within: Within) -> None:
    lived = live(Fault(ALWAYS[0], link, "loss", ALWAYS[1], 0.01))
    assert lived.states() == ASSEMBLED
    # The conveyor goes on for a cycle while the robot holds.
    within(ADDED, added(lived, undisturbed()), 0.106 * CYCLE_S * 1e3)


def test_r2_telegrams_lost_in_a_row_end_the_motion_and_many_are_a_fault(within: Within) -> None:
    lived = live(Fault(FREE_S, "robot", "silence", 4.5 * CYCLE_S))
    at_s = next(at for at, row in lived.rows.items() if at > FREE_S and row.state != "track")
    assert lived.rows[at_s].state in {"hold", "retreat"}
    within("to the end of the motion, s", at_s - FREE_S, 5.5 * CYCLE_S)
    lived = live(Fault(FREE_S, "robot", "silence", 12 * CYCLE_S))
    within("to the fault, s", lived.entered(State.FAULT, FREE_S) - FREE_S, 0.1 + 2 * CYCLE_S)


@pytest.mark.parametrize(("silent_s", "is_borne"), [(0.025, True), (0.045, False)])
@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_r2_the_same_silence_is_borne_at_any_cycle(
    cycle_ms: CycleMs, silent_s: float, is_borne: bool
) -> None:
    silence = Fault(FREE_S, "robot", "silence", silent_s)
    lived = Lived(FaultPlan(0, duration_s=2.6, faults=(silence,), cycle_ms=cycle_ms))
    lived.live()
    assert lived.outcome().violations == ()
    assert lived.world.collision is None
    assert (lived.states() == ASSEMBLED) == is_borne


def test_r4_a_flipped_counter_costs_three_answers_at_most_and_a_restart_needs_arming(
    within: Within,
) -> None:
    lived = live(Fault(FREE_S, "robot", "ipoc_flip", 1.5 * CYCLE_S, 1.0))
    within("answers lost", lived.controller.counts.lost, 3)
    lived = live(Fault(FREE_S, "robot", "restart", 0.05))
    # A program needs a while to start again, however short the pause that was asked for.
    assert lived.entered(State.FAULT, FREE_S) < FREE_S + SHORTEST_PAUSE_S + 5 * CYCLE_S


def test_r6_a_second_controller_costs_the_first_one_nothing() -> None:
    lived = live(Fault(FREE_S, "robot", "second", 1.0))
    assert lived.states() == ASSEMBLED
    assert lived.controller.counts.lost == lived.controller.counts.late == 0


def test_r9_drives_off_end_the_motion() -> None:
    lived = live(Fault(FREE_S, "robot", "drives_off", 0.5))
    assert lived.entered(State.FAULT, FREE_S) > FREE_S


# P: the process and its host.


@pytest.mark.parametrize("lasting_s", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("at_s", [FREE_S, IN_CONTACT_S])
def test_p1_a_stopped_process_misses_what_passed_and_two(
    at_s: float, lasting_s: float, within: Within
) -> None:
    # A robot that no one answers stands, and the car takes its wheel along.
    away = lasting_s > 0.1 and at_s == IN_CONTACT_S
    lived = live(Fault(at_s, "daemon", "stall", lasting_s), may_touch=away)
    # Each programme that is started again misses two of its own.
    within("telegrams missed", lived.missed, np.ceil(lasting_s / CYCLE_S) + 2)


def test_p2_a_daemon_back_from_a_crash_moves_nothing() -> None:
    lived = live(Fault(FREE_S, "daemon", "crash", 0.35))
    after = [row for at, row in lived.rows.items() if FREE_S + 0.4 < at < FREE_S + 0.9]
    assert after
    assert {row.state for row in after} <= {"init", "idle", "fault"}
    assert len({row.setpoints for row in after}) == 1


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, -1.0])
def test_p8_a_step_of_the_wall_clock_changes_not_one_bit(step_s: float) -> None:
    lived, reference = live(Fault(FREE_S, "daemon", "wall_step", 0.0, step_s)), undisturbed()
    same = [at for at in lived.rows if at in reference.rows and at < 2.4]
    assert len(same) > 200
    assert all(lived.rows[at].setpoints == reference.rows[at].setpoints for at in same)
