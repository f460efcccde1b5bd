"""Cars in front of a robot that stands: one clock, one reading, and a world a car."""

import pytest

from linemate.simulators.devices.line.car_feeder import STANDS_S, CarEvent, CarFeeder
from linemate.simulators.devices.line.cars import Car, CarFault, LinePlan
from linemate.simulators.plants.conveyor_plan import Conveyor
from linemate.simulators.plants.scenario import Body, Scenario

T0 = 0.012
TAKT_S = 3.0
PLAN = LinePlan(
    (Car("P1", "low", 1), Car("P2", "high", 2, fault=CarFault.PART_MISSING), Car("P3", "low", 3)),
    {"low": (2.2, 0.0, 1.1), "high": (2.2, 0.0, 1.2)},
    takt_s=TAKT_S,
    entry_s=1.0,
    first_s=0.5,
    last_s=2.0,
)


class Robot:
    """A controller that sends its robot to the same place in each cycle, or moves it."""

    def __init__(self) -> None:
        # Each car exactly where its variant says.
        body = Body(offset=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0), swings=())
        scenario = Scenario(cycle_s=T0, conveyor=Conveyor(events=()), body=body)
        self.feeder = CarFeeder(scenario, PLAN)
        self.line = self.feeder.line
        self.setpoints = self.line.start
        self.cycle = 0
        self.events: list[tuple[float, CarEvent]] = []
        self.camera: list[float] = []
        self.readings: list[tuple[float, float]] = []

    def run(self, duration_s: float, *, moves: bool = False) -> None:
        for _ in range(round(duration_s / T0)):
            if moves:
                self.setpoints = (self.setpoints[0] + 1e-6, *self.setpoints[1:])
            event = self.feeder.next_event(self.setpoints, self.cycle)
            if event is not None:
                self.events.append((self.line.time_s, event))
            self.line.command(self.setpoints, self.cycle)
            self.cycle += 1
            self.line.advance(self.line.cycle_start(self.cycle))
            self.camera += [each.exposure_s for each in self.line.take_camera()]
            self.readings += [(d.exposure_s, d.position) for d in self.line.take_distance()]
            self.line.take_wrench()


@pytest.fixture(scope="module")
def shift() -> Robot:
    robot = Robot()
    robot.run(12.0)
    return robot


def test_cars_come_in_their_order_at_the_takt_and_the_line_ends(shift: Robot) -> None:
    entered = [event.entered.part for _, event in shift.events if event.entered is not None]
    assert entered == ["P1", "P2", "P3"]
    times = [at for at, _ in shift.events]
    assert times[1] - times[0] == pytest.approx(TAKT_S, abs=2 * T0)
    assert shift.feeder.is_over
    left = [event.left[0].part for _, event in shift.events if event.left is not None]
    assert left == ["P1", "P2", "P3"]
    assert not any(event.left[1].mounted for _, event in shift.events if event.left is not None)


def test_the_reading_goes_on_from_car_to_car(shift: Robot) -> None:
    times, places = zip(*shift.readings, strict=True)
    assert list(times) == sorted(times)
    for (t1, p1), (t2, p2) in zip(shift.readings, shift.readings[1:], strict=False):
        # An outlier of the sensor is within 0.1 m, and the line goes 0.106 m/s.
        assert abs(p2 - p1 - 0.106 * (t2 - t1)) < 0.21
    assert places[-1] - places[0] == pytest.approx(0.106 * (times[-1] - times[0]), abs=0.2)


def test_the_camera_sees_only_cars_with_a_part(shift: Robot) -> None:
    spans = [at for at, event in shift.events if event.entered is not None]
    first = [t for t in shift.camera if t < spans[0]]
    missing = [t for t in shift.camera if spans[1] + 0.2 < t < spans[2]]
    seen = [t for t in shift.camera if spans[0] + 0.2 < t < spans[1]]
    assert not first
    assert not missing
    assert len(seen) > 10


def test_a_car_waits_for_a_robot_that_moves() -> None:
    robot = Robot()
    robot.run(2.0, moves=True)
    assert not robot.events
    robot.run(STANDS_S + 0.1)
    assert len(robot.events) == 1
    assert robot.line.cycle_start(robot.cycle) == pytest.approx(robot.cycle * T0)


def test_the_nominal_hub_is_that_of_the_variant(shift: Robot) -> None:
    robot = Robot()
    robot.run(1.0)
    low = robot.line.hub_pose()[2, 3]
    robot.run(TAKT_S)
    high = robot.line.hub_pose()[2, 3]
    assert robot.line.car.variant == "high"
    assert high - low == pytest.approx(0.1, abs=1e-6)
    assert shift.feeder.complaint is None
