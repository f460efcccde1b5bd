"""Rows of the MuJoCo world: what each changes of its station."""

from collections.abc import Callable
from dataclasses import dataclass

from linemate.simulators.harness import setup
from linemate.simulators.harness.setup import Setup
from linemate.simulators.lab.world import drawn_station


@dataclass(frozen=True, slots=True)
class MujocoRow:
    """One row.

    Attributes:
        what: what is different, in one line.
        sets: ``KEY=VALUE`` of the station.
        scenario: orders to the conveyor.
        draw: what a seed changes as well, as ``KEY=VALUE``.
    """

    what: str
    sets: tuple[str, ...] = ()
    scenario: str = "wheel"
    draw: Callable[[int], tuple[str, ...]] | None = None


def _car(hz: float, damping: float) -> tuple[str, ...]:
    return (f"mujoco.car.fore_aft_hz={hz}", f"mujoco.car.fore_aft_damping={damping}")


MUJOCO_ROWS = {
    "mujoco": MujocoRow("the MuJoCo station as its seed draws it"),
    "mujoco-no-stop": MujocoRow("the same, never stopped", scenario="no-stop"),
    "mujoco-stop-in-contact": MujocoRow("the same, stopped in contact", scenario="stop-in-contact"),
    "mujoco-0.62hz": MujocoRow("car with a fore-aft mode of 0.62 Hz, 1 %", _car(0.62, 0.01)),
    "mujoco-1.2hz": MujocoRow("car with a fore-aft mode of 1.2 Hz, 2 %", _car(1.2, 0.02)),
    "mujoco-4.7hz-0.9pct": MujocoRow("car with a fore-aft mode of 4.7 Hz, 0.9 %", _car(4.7, 0.009)),
    "mujoco-4.7hz-4pct": MujocoRow("car with a fore-aft mode of 4.7 Hz, 4 %", _car(4.7, 0.04)),
    "mujoco-loose-holes": MujocoRow(
        "bolt holes 1 mm wider all around", ("mujoco.tool.hole_clearance=1.0e-3",)
    ),
    "mujoco-soft-mount": MujocoRow(
        "a mount 0.57 times as stiff as specified", ("mujoco.tool.stiffness_share=0.57",)
    ),
    "mujoco-late-stamp": MujocoRow(
        "camera dated 15 ms late", ("mujoco.sensors.camera_stamp_s=0.015",)
    ),
    "mujoco-blind": MujocoRow("camera blind below 60 mm", ("mujoco.sensors.camera_blind=0.060",)),
    "mujoco-askew": MujocoRow("conveyor askew by 10 mrad", ("mujoco.line.askew=0.010",)),
    "mujoco-light-car": MujocoRow(
        "a body of 300 kg", ("mujoco.car.mass=300.0", "mujoco.car.inertia=[370.0, 120.0, 430.0]")
    ),
    "mujoco-drawn": MujocoRow(drawn_station.WHAT, draw=drawn_station.overrides),
    "mujoco-drawn-weighed": MujocoRow(drawn_station.WEIGHED, draw=drawn_station.weighed_overrides),
}
DRAWN = {name: row.what for name, row in MUJOCO_ROWS.items() if row.draw is not None}
"""Rows of which each seed draws its own, and what they are."""


def prepared(
    name: str, overrides: tuple[str, ...], cycle_ms: float | None, seed: int | None
) -> Setup:
    """Return the runs of a row before their seeds.

    Args:
        seed: which station is drawn; None for a row that draws none.
    """
    row = MUJOCO_ROWS[name]
    drawn = () if row.draw is None or seed is None else row.draw(seed)
    sets = (*row.sets, *drawn, *overrides)
    return setup.make(row.scenario, sets, cycle_ms=cycle_ms, world="mujoco")
