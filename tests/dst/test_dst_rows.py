"""Rows X1 to X19 of the second catalogue: whole runs with the figures that each row names.

A run is judged by all oracles of the fault campaign.
"""

import random
from dataclasses import replace
from typing import Any

import pytest

from linemate.daemon.config import config
from linemate.daemon.config.documents import FileError
from linemate.simulators.lab.faults import dst_plan, dst_plan_rows, dst_run
from linemate.simulators.lab.faults.dst_cells import TASKS
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.lab.faults.dst_run import Simulation
from linemate.simulators.plants.contact_plant import WHEEL_RELEASED, ContactPlant
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Fault

pytestmark = pytest.mark.row

FREE_S, SLOW_S, TOUCH_S, HELD_S = 0.15, 0.6, 1.05, 1.45
"""Before the last approach, at its touch speed, at the touch, in contact: scenario time [s]."""
ALWAYS = (-1.4, 3.6)
NO_FORCE = "no-force"
STOP, START = 0.104, 0.013


def lived(*faults: Fault, **fields: Any) -> Simulation:
    """Run a plan, and have nothing to blame."""
    plan = FaultPlan(fields.pop("seed", 1), duration_s=fields.pop("duration_s", 1.9), faults=faults)
    simulation = Simulation(replace(plan, **fields))
    simulation.live()
    assert simulation.outcome().violations == ()
    return simulation


@pytest.mark.parametrize("at_s", [FREE_S, HELD_S])
@pytest.mark.parametrize("cycles", [8, 60, 417, 1_000_000, 0])
def test_x1_a_counter_that_jumps_without_a_restart_moves_no_robot(at_s: float, cycles: int) -> None:
    lived(Fault(at_s, "robot", "ipoc_jump", 0.0, float(cycles)))


@pytest.mark.parametrize("at_s", [FREE_S, HELD_S])
@pytest.mark.parametrize("lasting_s", [0.05, 0.36, 1.08, 2.0])
def test_x2_a_machine_that_was_paused_moves_no_robot_beyond_its_limits(
    at_s: float, lasting_s: float
) -> None:
    lived(Fault(at_s, "daemon", "pause", lasting_s))


@pytest.mark.parametrize("at_s", [FREE_S, HELD_S])
@pytest.mark.parametrize("kind", [0.0, 1.0])
def test_x3_a_controller_from_another_port_or_address_is_held_until_it_is_proven(
    at_s: float, kind: float
) -> None:
    lived(Fault(at_s, "robot", "readdress", 0.0, kind))


@pytest.mark.parametrize("at_s", [FREE_S, HELD_S])
@pytest.mark.parametrize("ahead", [50.0, 1e6])
def test_x4_forged_telegrams_are_not_answered_with_a_correction(at_s: float, ahead: float) -> None:
    lived(Fault(at_s, "robot", "forged", 0.006, ahead, 3))


@pytest.mark.parametrize("at_s", [FREE_S, HELD_S])
@pytest.mark.parametrize("lasting_s", [0.05, 0.1, 0.4, 2.4])
def test_x5_a_daemon_that_is_back_soon_moves_no_robot(at_s: float, lasting_s: float) -> None:
    lived(Fault(at_s, "daemon", "crash", lasting_s))


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
def test_x6_lost_replies_leave_no_limit(share: float) -> None:
    lived(Fault(FREE_S, "reply", "loss", 1.0, share))


@pytest.mark.parametrize("mean_s", [0.001, 0.003, 0.006, 0.012])
def test_x7_jitter_of_telegrams_makes_no_clock_race_and_no_tool_miss(mean_s: float) -> None:
    lived(Fault(0.4, "robot", "jitter", 1.0, mean_s))


@pytest.mark.row
@pytest.mark.parametrize("cycle_ms", [12, 4])
@pytest.mark.parametrize("lasting_s", [0.02, 0.07, 0.1, 0.14])
def test_x8_telegrams_lost_in_contact_cost_no_mount(lasting_s: float, cycle_ms: int) -> None:
    lived(Fault(HELD_S, "robot", "silence", lasting_s), cycle_ms=cycle_ms)


CLOSE = [
    (0.35, 0.12),
    (0.45, 0.07),
    (0.8, 0.07),
    (0.8, 0.25),
    (0.85, 0.12),
    (0.9, 0.07),
    (0.9, 0.12),
    (0.9, 0.25),
    (0.95, 0.07),
    (0.95, 0.12),
    (1.0, 0.1),
    (1.0, 0.12),
    (1.06, 0.1),
]


@pytest.mark.row
@pytest.mark.parametrize("lead_ms", [0.0, 5.0])
@pytest.mark.parametrize(("at_s", "lasting_s"), CLOSE)
def test_x8_telegrams_lost_close_to_the_hub_lead_the_tool_past_no_hub(
    at_s: float, lasting_s: float, lead_ms: float
) -> None:
    lived(Fault(at_s, "robot", "silence", lasting_s), lead_ms=lead_ms)


@pytest.mark.parametrize(
    "fault",
    [
        Fault(HELD_S, "operator", "stop"),
        Fault(HELD_S, "operator", "retreat"),
        Fault(HELD_S, "force_torque", "silence", 0.4),
        Fault(HELD_S, "distance", "silence", 0.4),
    ],
    ids=lambda fault: f"{fault.link}-{fault.kind}",
)
def test_x9_a_retreat_with_the_tool_clamped_waits_for_the_clamp(fault: Fault) -> None:
    lived(fault, duration_s=2.6)


@pytest.mark.parametrize("stop_s", [0.85, 1.05, 1.3])
@pytest.mark.parametrize("after_s", [0.32, 0.8])
def test_x10_a_stop_and_a_start_around_contact_overload_no_mount(
    stop_s: float, after_s: float
) -> None:
    stop = ConveyorEvent("stop", stop_s, STOP)
    lived(events=(stop, ConveyorEvent("start", stop_s + after_s, START)), duration_s=2.6)


@pytest.mark.parametrize("acceleration", [1e-4, 1e-3])
def test_x11_a_start_that_does_not_speed_up_leads_no_rail_away(acceleration: float) -> None:
    stop, start = ConveyorEvent("stop", 0.7, STOP), ConveyorEvent("start", 2.0, acceleration)
    lived(events=(stop, start), duration_s=3.0)


@pytest.mark.parametrize(
    ("kind", "value", "lasting_s"),
    [
        ("silence", 0.0, 0.3),
        ("silence", 0.0, 1.2),
        ("frame", 0.0, 0.6),
        ("flipped", 0.0, 0.6),
        ("offset", 0.03, 0.6),
        ("clock_step", 0.02, 0.6),
        ("clock_step", -0.02, 0.6),
    ],
)
def test_x12_a_camera_that_is_covered_or_wrong_before_contact_leads_into_no_collision(
    kind: str, value: float, lasting_s: float
) -> None:
    lived(Fault(TOUCH_S - lasting_s, "camera", kind, lasting_s, value), duration_s=2.6)


@pytest.mark.parametrize(
    ("kind", "value", "at_s"),
    [
        ("offset", 0.03, FREE_S),
        ("offset", 0.03, TOUCH_S),
        ("delay", 0.02, FREE_S),
        ("delay", 0.02, SLOW_S),
        ("delay", 0.02, TOUCH_S),
        ("stuck", 0.0, FREE_S),
        ("stuck", 0.0, TOUCH_S),
    ],
)
def test_x13_a_distance_that_is_off_late_or_frozen_leads_into_no_collision(
    at_s: float, kind: str, value: float
) -> None:
    lived(Fault(at_s, "distance", kind, 0.6, value))


@pytest.mark.parametrize(
    ("kind", "value"),
    [("offset", 20.0), ("scale", -1.0), ("flip", 0.3), ("stuck", 0.0), ("clock_frozen", 0.0)],
)
def test_x14_a_wrench_that_is_wrong_costs_no_mount(kind: str, value: float) -> None:
    lived(Fault(TOUCH_S, "force_torque", kind, 0.6, value, 1), duration_s=2.6)


@pytest.mark.parametrize("off_m", [-0.01, -0.005, -0.002, 0.002, 0.005, 0.01])
def test_x15_an_object_that_is_nearer_or_farther_than_seen_is_touched_gently(off_m: float) -> None:
    lived(Fault(ALWAYS[0], "camera", "offset", 4.0, off_m, 3), duration_s=2.6)


@pytest.mark.parametrize("off", [-0.1, -0.06, -0.02, 0.02, 0.06, 0.1])
def test_x16_a_controller_of_another_cycle_is_not_tracked_for(off: float) -> None:
    simulation = lived(cycle_off=off)
    assert ("track" in simulation.oracle.states) == (abs(off) < 0.05)


@pytest.mark.parametrize("lead_ms", [0.0, 5.0])
@pytest.mark.parametrize("drift", [-0.01, -0.002, 0.002, 0.01])
def test_x16_a_controller_whose_cycle_drifts_by_up_to_3_percent_is_followed(
    drift: float, lead_ms: float
) -> None:
    simulation = lived(cycle_drift=drift, lead_ms=lead_ms, duration_s=2.4)
    counts = simulation.controller.counts
    assert counts.sent - 1 <= counts.answered <= counts.sent  # the last reply may still travel
    assert counts.answered > 200
    assert counts.late == counts.lost == counts.refused == 0
    assert simulation.world.released_s is not None


def test_x17_a_telegram_with_exponents_is_read() -> None:
    simulation = lived(Fault(ALWAYS[0], "robot", "exponent", ALWAYS[1] + 1.0, 1.0))
    assert "contact" in simulation.oracle.states


@pytest.mark.parametrize(("share", "lasting_s"), [(0.05, 1.0), (1.0, 1.0)])
def test_x17_a_telegram_with_an_unreadable_value_is_answered(
    share: float, lasting_s: float
) -> None:
    lived(Fault(FREE_S, "robot", "unreadable", lasting_s, share))


@pytest.mark.parametrize("cell", sorted(dst_plan.CELLS))
def test_other_cells_assemble_the_wheel(cell: str) -> None:
    simulation = lived(cell=cell, duration_s=2.6)
    assert simulation.world.released_s is not None


@pytest.mark.parametrize("cycle_ms", [12, 4])
@pytest.mark.parametrize("seed", range(1, 7))
def test_a_cell_without_a_force_sensor_assembles_the_wheel_below_200_n(
    seed: int, cycle_ms: int
) -> None:
    simulation = lived(seed=seed, cell=NO_FORCE, cycle_ms=cycle_ms, duration_s=2.6)
    assert "contact" in simulation.oracle.states
    assert simulation.world.released_s is not None


@pytest.mark.parametrize(("seed", "cycle_ms"), [(1, 12), (2, 12), (1, 4)])
def test_a_clamp_that_opens_lets_no_press_go(seed: int, cycle_ms: int) -> None:
    simulation = Simulation(FaultPlan(seed, duration_s=2.6, cycle_ms=cycle_ms))
    look, world, held = simulation._judge_cycle, simulation.world, [0.0]
    stiffness = world.scenario.effector.stiffness[2]

    def watch() -> None:
        look()
        if world.contact == "clamped":
            held[0] = stiffness * world.deflection()[2]

    simulation._judge_cycle = watch  # type: ignore[method-assign]
    simulation.live()
    assert world.released_s is not None
    assert abs(held[0]) < 10.0  # the programme presses with 50 N until then


@pytest.mark.parametrize("op", ["stop", "retreat"])
@pytest.mark.parametrize("at_s", [FREE_S, 1.15, HELD_S])
def test_a_retreat_without_a_force_sensor_waits_for_the_clamp(at_s: float, op: str) -> None:
    lived(Fault(at_s, "operator", op), cell=NO_FORCE, duration_s=2.6)


def test_a_tool_without_a_force_sensor_is_not_in_contact_while_its_clamp_is_reported_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ContactPlant, "signals", WHEEL_RELEASED)
    simulation = Simulation(FaultPlan(1, duration_s=1.5, cell=NO_FORCE))
    simulation.live()
    assert "track" in simulation.oracle.states
    assert "contact" not in simulation.oracle.states


def test_x5_a_layout_without_delay_is_refused_at_the_check(tmp_path: Any) -> None:
    from linemate.simulators.devices.links.emulator_config import SHIPPED_RSI

    lines = SHIPPED_RSI.read_text(encoding="utf-8").splitlines()
    without = [line for line in lines if "DEF_Delay" not in line]
    (tmp_path / "site.xml").write_text("\n".join(without), encoding="utf-8")
    text = (TASKS / "dst_daemon.yaml").read_text(encoding="utf-8")
    text = text.replace("rsi_joints.xml", "site.xml").replace("dst.yaml", "wheel.yaml")
    (tmp_path / "linemate.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="Delay"):
        config.load(tmp_path / "linemate.yaml")


@pytest.mark.parametrize("operators", [1, 2])
def test_x19_parameters_and_orders_of_two_operators_in_motion_cost_no_cycle(operators: int) -> None:
    orders = [Fault(0.3 + 0.05 * n, "operator", "set", 0.0, 0.0, n) for n in range(4)]
    simulation = lived(*orders, Fault(0.6, "operator", "arm"), operators=operators)
    counts = simulation.controller.counts
    assert counts.late == counts.lost == counts.refused == 0
    assert "contact" in simulation.oracle.states


def test_every_row_that_is_a_fault_of_a_run_can_be_drawn_and_comes_back_from_its_line() -> None:
    for name, row in dst_plan_rows.ROWS.items():
        for seed in range(20):
            changes = row(random.Random(seed), 0.012)
            plan = FaultPlan(seed, row=name, **changes)
            assert dst_plan.from_line(plan.to_line()) == plan
            dst_run.Faults(plan.faults)


def test_a_quarter_of_the_seeds_draws_a_row_and_every_row_and_cell_is_drawn() -> None:
    plans = [dst_plan.draw(seed) for seed in range(2000)]
    assert {plan.row for plan in plans if plan.row} == set(dst_plan_rows.ROWS)
    assert all(plan.row for plan in plans[3::4])
    assert {plan.cell for plan in plans} == {"", *dst_plan.CELLS}
    assert {plan.operators for plan in plans} == {0, 1, 2}
