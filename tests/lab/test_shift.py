"""A short share of a shift: quick assemblies of two variants, one car with each fault.

The whole service runs in virtual time, driven through the command protocol alone.
"""

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from linemate.daemon.config import config
from linemate.daemon.operator.render import as_json
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceEncoder, DistanceError
from linemate.simulators import harness
from linemate.simulators.devices.line.cars import Car, CarFault, CarTruth
from linemate.simulators.harness.line import line_station
from linemate.simulators.harness.line.line_station import LineStation
from linemate.simulators.lab.shift import plan, shift
from linemate.simulators.lab.shift.opc_line import OpcLineController
from linemate.simulators.lab.shift.run import ShiftOutcome, ShiftRun, run
from linemate.simulators.plants.conveyor_plan import Conveyor, ConveyorEvent
from linemate.simulators.plants.forces.switches import Load
from linemate.simulators.plants.scenario import Body, Contact, Effector, Robot, Scenario, Swing

TASK = Path(harness.__path__[0]) / "data" / "tasks" / "dst.yaml"
REST = (0.0, -1.3829204815564327, 1.5925020939891852, 0.0, 1.3612147143621445, 0.0, 0.0)
ENTRY_S, TAKT_S = 1.5, 7.0
HUBS = {"low": 1.09, "high": 1.11}
STATION = f"""
task: low.yaml
rsi: {{config: rsi_joints.xml, port: 49152}}
distance: {{can: {{interface: virtual}}}}
camera: {{port: 49153}}
force_torque: {{url: virtual}}
realtime: {{freeze_collector: false}}
watch: {{healthy_cycles: 20}}
tracking: {{merge: {{blend: 0.5}}}}
production:
  variants: {{low: low.yaml, high: high.yaml}}
  window: {{start: -0.15, latest_start: -0.02, abort: 0.8}}
  announced_at: {-ENTRY_S * 0.106}
"""
CARS = (
    Car("P1", "low", 11),
    Car("P2", "high", 12, fault=CarFault.CAMERA_COVERED, fault_s=0.0),
    Car("P3", "low", 13, fault=CarFault.ROBOT_RESTARTED, fault_s=0.4),
    Car("P4", "high", 14, events=(ConveyorEvent("stop", 0.9, 0.104),)),
    Car("P5", "high", 15),
)
GOOD = ("P1", "P5")


def station(folder: Path, settings: str = STATION, done_s: float = 3.33) -> LineStation:
    text = TASK.read_text().replace("start_position: 0.0", "start_position: 1.0")
    text = text.replace("time: 3.33", f"time: {done_s}")
    for name, height in HUBS.items():
        placed = text.replace(
            "nominal: {position: [2.20, 0.0, 1.10]", f"nominal: {{position: [2.20, 0.0, {height:g}]"
        )
        (folder / f"{name}.yaml").write_text(placed)
    (folder / "station.yaml").write_text(settings)
    scenario = Scenario(
        name="shift",
        seed=1,
        lead_in_s=ENTRY_S,
        conveyor=Conveyor(events=()),
        body=Body(
            offset_range=(0.008, 0.008, 0.008), tilt=0.05, swings=(Swing(amplitude_max=3e-3),)
        ),
        robot=Robot(start=REST),
        contact=Contact(nutrunner_s=0.2),
    )
    return LineStation(config.load(folder / "station.yaml"), scenario)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> ShiftOutcome:
    """About 6 s: 40 s of virtual time."""
    folder = tmp_path_factory.mktemp("shift")
    records = folder / "records"
    records.mkdir()
    return run(station(folder), CARS, TAKT_S, records)


@pytest.mark.row("one shift")
def test_every_good_car_is_mounted_and_every_other_one_reported_with_its_cause(
    outcome: ShiftOutcome,
) -> None:
    result = shift.judge([outcome], 1)
    assert result["good"], as_json(result)
    assert {row["id"] for row in result["cars"] if row["mounted"]} >= set(GOOD)
    assert [record["part"] for record in outcome.records] == [car.part for car in CARS]


@pytest.mark.row("one shift")
def test_the_lines_controller_types_no_order(outcome: ShiftOutcome) -> None:
    assert set(outcome.requests) <= {"announce", "queue", "next", "ack"}
    assert outcome.requests["announce"] == len(CARS)


@pytest.mark.row
@pytest.mark.parametrize("family", ["fanuc", "egm"])
def test_a_shift_behind_another_controller_mounts_and_reports_the_same_cars(
    family: str, tmp_path: Path
) -> None:
    records = tmp_path / "records"
    records.mkdir()
    made = line_station.behind(station(tmp_path), family)
    good, restarted = CARS[0], CARS[2]
    outcome = run(made, (good, restarted), TAKT_S, records)
    result = shift.judge([outcome], 1)
    assert made.files.config.controller.kind.value == family
    assert result["good"], as_json(result)
    assert [row["mounted"] for row in result["cars"]] == [True, False]


@pytest.mark.row
def test_a_line_that_speaks_opc_ua_alone_drives_a_shift(tmp_path: Path) -> None:
    """asyncua's client against the server of ``linemate plc``, in another process."""
    records = tmp_path / "records"
    records.mkdir()
    with closing(OpcLineController()) as plc:
        outcome = run(station(tmp_path), CARS[:2], TAKT_S, records, plc=plc)
    result = shift.judge([outcome], 1)
    assert result["good"], as_json(result)
    assert [row["mounted"] for row in result["cars"]] == [True, False]
    assert outcome.requests["announce"] == 2
    assert set(outcome.requests) <= {"announce", "queue", "next", "ack"}


@pytest.mark.row
def test_a_method_that_is_refused_over_opc_ua_has_its_reason(tmp_path: Path) -> None:
    records = tmp_path / "records"
    records.mkdir()
    with closing(OpcLineController()) as plc:
        twice = [CARS[0], CARS[0]]
        ShiftRun(station(tmp_path), twice, TAKT_S, records, plc=plc).run()
        assert plc.refusals[0].startswith("announce: ")
        assert "P1" in plc.refusals[0]


@pytest.mark.row("one shift")
def test_a_record_has_the_times_and_the_force_of_the_part(outcome: ShiftOutcome) -> None:
    record = outcome.records[0]
    times = record["times_s"]
    order = ["armed", "track", "seen", "contact", "screws_fixed", "release", "released"]
    assert [times[name] for name in order] == sorted(times[name] for name in order)
    assert 0.0 < record["force"]["impact_n"] <= record["force"]["largest_n"]
    assert record["variant"] == "low"


@pytest.mark.row
def test_a_good_car_corrects_the_camera_for_the_next_one(tmp_path: Path) -> None:
    folder = tmp_path / "records"
    folder.mkdir()
    made = station(tmp_path, f"{STATION}learn_touches: true\n")
    taught = ShiftRun(made, CARS[:2], TAKT_S, folder)
    corrections: list[tuple[float, float]] = []

    def note(_car: Car, _truth: CarTruth) -> None:
        assert taught.app is not None
        corrections.append(taught.app.cycle.parameters.tracker.settings.camera.felt)

    taught._on_car = note
    taught.run()
    # The first one teaches after it has left, the second one fails.
    assert 0.0 < math.hypot(*corrections[1]) < 1e-3


@pytest.mark.row
def test_a_good_car_shows_what_its_wheel_weighs(tmp_path: Path) -> None:
    folder = tmp_path / "records"
    folder.mkdir()
    made = station(tmp_path, f"{STATION}learn_part_mass: true\n", done_s=3.7)
    load = Effector(load=Load(wheel_mass=25.0))
    made = replace(made, scenario=replace(made.scenario, effector=load))
    taught = ShiftRun(made, CARS[:1], TAKT_S, folder)
    taught.run()
    assert taught.app is not None
    payload = taught.app.cycle.parameters.tracker.settings.payload
    assert payload.part_mass == pytest.approx(25.0, abs=1.0)


def rows(**changes: object) -> dict[str, object]:
    truth = CarTruth(mounted=True, collision=None, impact_mm=0.1)
    record = {
        "part": "P1",
        "ok": True,
        "reason": "",
        "duration_s": 3.0,
        "force": {"largest_n": 50.0},
    }
    given = {
        "cars": (Car("P1", "low", 1),),
        "truths": (truth,),
        "records": (record,),
        "growth": (100, 100),
        "resident": (10**8, 10**8),
        "files": 100,
        "duration_s": 10.0,
        "requests": {},
        "complaints": (),
        "planned": 1,
    } | changes
    return shift.judge([ShiftOutcome(**given)], 1)  # type: ignore[arg-type]


def test_the_judge_sees_a_good_car_that_was_not_mounted() -> None:
    assert rows()["good"]
    missed = rows(truths=(CarTruth(False, None, None),))
    assert (missed["good"], missed["unmounted_good"], missed["mounted_bad"]) == (False, 1, 1)


def test_the_judge_sees_a_car_without_a_record_or_with_another_cause() -> None:
    assert rows(records=())["unreported"] == 1
    covered = (Car("P1", "low", 1, fault=CarFault.CAMERA_COVERED),)
    wrong = {
        "part": "P1",
        "ok": False,
        "reason": "overload",
        "duration_s": 3.0,
        "force": {"largest_n": None},
    }
    assert rows(cars=covered, records=(wrong,))["wrong_cause"] == 1


def test_the_judge_sees_growth() -> None:
    assert "remembers" in str(rows(growth=(100, 120))["complaints"])
    assert "record files" in str(rows(files=100_000)["complaints"])
    assert rows(resident=(10**8, 10**8 + shift.RESIDENT_GROWTH))["good"]
    grown = rows(resident=(10**8, 10**8 + shift.RESIDENT_GROWTH + 1))
    assert "has grown by 33554433 bytes, limit 33554432" in str(grown["complaints"])


@pytest.mark.row("one shift")
def test_the_memory_of_a_shift_is_measured(outcome: ShiftOutcome) -> None:
    first, last = outcome.resident
    assert 10**7 < first <= last + 2**20
    assert last - first < shift.RESIDENT_GROWTH


def test_a_split_has_each_car_once_in_order_and_no_empty_share() -> None:
    cars = plan.draw(7, 3, line_station.station())
    shares = shift.split(cars, 3, 57.6)
    assert [len(share.cars) for share in shares] == [2, 2, 3]
    assert [car for share in shares for car in share.cars] == cars
    assert len(shift.split(cars, 100, 57.6)) == 7


def test_a_shift_whose_time_is_over_ends_with_its_present_car(tmp_path: Path) -> None:
    (tmp_path / "records").mkdir()
    ended = run(station(tmp_path), CARS, TAKT_S, tmp_path / "records", longest_s=0.0)
    result = shift.judge([ended], 1)
    assert result["good"], as_json(result)
    assert [row["id"] for row in result["cars"]] == ["P1"]
    assert (result["planned"], result["unreported"]) == (len(CARS), 0)
    assert f"1 of {len(CARS)} cars" in shift.table(result)


@pytest.mark.row("one shift")
def test_a_split_shift_is_judged_as_one(outcome: ShiftOutcome) -> None:
    here = shift.judge([outcome, outcome], 1)
    assert here["resident_bytes"] == [list(outcome.resident)] * 2
    assert len(here["cars"]) == 2 * len(CARS)


def test_a_plan_has_its_share_of_faults_and_is_the_same_for_a_seed() -> None:
    shipped = line_station.station()
    drawn = plan.draw(400, 3, shipped)
    assert drawn == plan.draw(400, 3, shipped)
    faults = [car.fault for car in drawn if car.fault is not None]
    assert len(faults) == 8
    assert {faults.count(kind) for kind in CarFault} == {2}
    assert len({car.part for car in drawn}) == 400
    assert drawn != plan.draw(400, 4, shipped)


@pytest.mark.parametrize("cell", [None, "kr10"])
def test_the_encoder_of_a_shipped_station_counts_for_a_whole_shift(cell: str | None) -> None:
    shipped = line_station.station(cell)
    text = shipped.files.dbc
    assert text is not None
    way_m = 8 * 3600 * shipped.scenario.conveyor.nominal_speed
    can_id, data = DistanceEncoder(text).encode(way_m)
    sample = DistanceDecoder(text).decode(can_id, data, 0)
    assert sample is not None
    assert sample.position == pytest.approx(way_m, abs=1e-4)
    with pytest.raises(DistanceError):  # the shipped message of a laser does not
        DistanceEncoder().encode(way_m)
