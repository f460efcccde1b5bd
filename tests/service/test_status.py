"""The status says healthy in a normal contact, and names what is wrong in any other state."""

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from linemate.daemon.config import config
from linemate.daemon.core.control import dead_time
from linemate.daemon.core.control.dead_time import compile_drift
from linemate.daemon.core.control.settings import ControlSettings, DeadTimeDrift
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.classifiers.distance.measured_noise import (
    AS_CONFIGURED,
    MeasuredNoise,
)
from linemate.daemon.core.tracking.observation import Wrench
from linemate.daemon.core.tracking.settings import PayloadSettings
from linemate.daemon.core.tracking.touch import tare
from linemate.daemon.cycle.states import Link, Machine, Signals, State
from linemate.daemon.service import status
from linemate.daemon.service.app import App
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.notify import Notifier

CONFIG = """
task: wheel.yaml
rsi: {port: 0}
camera: {port: 0}
distance: {can: {interface: slcan, channel: can}}
force_torque: {url: virtual}
command: {socket: c.sock}
"""


@pytest.fixture
def app(tmp_path: Path, parameters: Parameters) -> App:
    path = tmp_path / "linemated.yaml"
    path.write_text(CONFIG)
    made = App(config.load(path), parameters, realtime.RealtimeHost(), Notifier())
    now_ns = time.monotonic_ns()
    for link in made._links:
        link.status.mark_up()
        link.status.last_sample_stamp_ns = now_ns
    made.cycle.operating.signals = replace(Signals(), link=Link.HEALTHY)
    return made


def silence(app: App, name: str, for_s: float) -> None:
    (link,) = [link for link in app._links if link.status.name == name]
    link.status.last_sample_stamp_ns = time.monotonic_ns() - round(for_s * 1e9)


@pytest.mark.parametrize("state", [State.CONTACT, State.RETREAT])
def test_a_camera_that_the_tool_covers_in_contact_leaves_the_daemon_healthy(
    app: App, state: State
) -> None:
    app.cycle.operating.machine = Machine(state)
    silence(app, "camera", 8.0)
    found = app.status()
    assert found["complaints"] == ()
    assert found["health"] == "healthy"


@pytest.mark.parametrize("state", [State.IDLE, State.ARMED, State.TRACK, State.HOLD])
def test_a_silent_camera_is_a_complaint_where_nothing_covers_it(app: App, state: State) -> None:
    app.cycle.operating.machine = Machine(state)
    silence(app, "camera", 8.0)
    assert app.status()["complaints"] == ("link camera is silent",)
    assert app.status()["health"] == "degraded"


def test_a_silent_robot_says_what_it_does_not_answer(app: App) -> None:
    silence(app, "robot", 8.0)
    app._robot.status.reason = "CAPABILITY sent, no answer."
    assert "link robot is silent: CAPABILITY sent, no answer." in app.status()["complaints"]


def test_a_robot_that_takes_no_setpoints_says_why(app: App) -> None:
    app.cycle.operating.signals = replace(Signals(), link=Link.UNPROVEN)
    app.cycle.session.unproven = "the controller takes no setpoints: emergency stop."
    (complaint,) = [text for text in app.status()["complaints"] if "robot link is" in text]
    assert complaint.endswith(": the controller takes no setpoints: emergency stop.")


@pytest.mark.parametrize("name", ["distance", "force_torque"])
def test_in_contact_every_other_sensor_must_be_heard(app: App, name: str) -> None:
    app.cycle.operating.machine = Machine(State.CONTACT)
    silence(app, name, 8.0)
    assert app.status()["complaints"] == (f"link {name} is silent",)


def test_a_camera_whose_port_is_closed_is_a_complaint_in_contact_too(app: App) -> None:
    app.cycle.operating.machine = Machine(State.CONTACT)
    (camera,) = [link for link in app._links if link.status.name == "camera"]
    camera.status.up, camera.status.reason = False, "the port is taken"
    assert app.status()["complaints"] == ("link camera is down: the port is taken",)


def test_a_fault_is_reported_with_its_cause(app: App) -> None:
    app.cycle.operating.machine = Machine(State.FAULT, latched=True)
    app.cycle.operating.cause = "held too long: in hold for 60.1 s, limit 60.0 s"
    status = app.status()
    assert status["complaints"] == ("fault: held too long: in hold for 60.1 s, limit 60.0 s",)
    assert status["cause"] == app.cycle.operating.cause
    assert status["health"] == "fault"


@pytest.mark.parametrize(("drift_ms", "is_complaint"), [(0.0, False), (95.0, False), (110.0, True)])
def test_a_dead_time_at_its_bound_is_a_complaint(
    app: App, drift_ms: float, is_complaint: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = {"drift_ms": drift_ms, "least_ms": 0.0, "most_ms": 110.0}
    monkeypatch.setattr(status, "dead_time", lambda _: shown)
    found = app.status()
    assert found["dead_time"] == shown
    assert any("drifted by 110.0 ms" in text for text in found["complaints"]) is is_complaint


@pytest.mark.parametrize(("shown", "is_complaint"), [(294.0, True), (100.0, True), (215.0, False)])
def test_a_payload_that_weighs_other_than_configured_is_a_complaint(
    app: App, shown: float, is_complaint: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = Wrench(np.array((shown, 0.0, 0.0)), np.zeros(3), 0, 1)
    mount, payload = app.cycle.parameters.tracker.settings.tactile, PayloadSettings(mass=20.0)
    down = (1.0, 0.0, 0.0)
    hung = tare.updated(tare.NO_TARE, free, down, down, payload, mount, 0.012)
    complaints = complained(app, monkeypatch, hung, 0.0)
    assert any("196 N by tracking.payload.mass" in each for each in complaints) is is_complaint


@pytest.mark.parametrize(
    ("lead", "text"), [(0.024, "24 ms more"), (-0.015, "15 ms less"), (0.008, "")]
)
def test_a_robot_that_lags_more_than_identified_is_a_complaint(
    app: App, lead: float, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    complaints = complained(app, monkeypatch, tare.NO_TARE, lead)
    lags = [each for each in complaints if "identify the servos" in each]
    assert [text in each for each in lags] == ([True] if text else [])


@pytest.mark.parametrize(("nis", "inflation"), [(1.9, 1.0), (23.0, 32.0)])
def test_a_distance_sensor_that_is_noisier_than_configured_is_a_complaint(
    app: App, nis: float, inflation: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = MeasuredNoise(nis=nis, inflation=inflation)
    complaints = complained(app, monkeypatch, tare.NO_TARE, 0.0, noise)
    shown = [each for each in complaints if "distance sensor noisier" in each]
    assert ["factor 4.8" in each for each in shown] == ([True] if inflation > 1.0 else [])


def complained(
    app: App,
    monkeypatch: pytest.MonkeyPatch,
    hung: tare.Tare,
    lead: float,
    noise: MeasuredNoise = AS_CONFIGURED,
) -> list[str]:
    """Return the complaints after a step with a tare, a lead and a distance sensor's noise."""
    tracker = SimpleNamespace(tare=hung, lead=lead, distance_noise=noise)
    after = SimpleNamespace(tracker=tracker, control=SimpleNamespace(drift=None))
    monkeypatch.setattr(app.cycle, "last", SimpleNamespace(after=after))
    monkeypatch.setattr(status, "covered", lambda _: frozenset())
    return [*status._complaints(app._snapshot(), {"link": "healthy"}, {})]


def test_the_drift_of_the_dead_time_is_that_of_the_last_step() -> None:
    model = compile_drift(ControlSettings(drift=DeadTimeDrift(longer=0.11)), 7, 0.012)
    assert model is not None
    state = structs.replace(dead_time.begin(model, np.zeros(7)), drift=0.0325)
    after = SimpleNamespace(control=SimpleNamespace(drift=state))
    controller = SimpleNamespace(drift=model)
    parameters = SimpleNamespace(controller=controller)
    cycle: Any = SimpleNamespace(parameters=parameters, last=SimpleNamespace(after=after))
    assert status.dead_time(cycle) == {"drift_ms": 32.5, "least_ms": 0.0, "most_ms": 110.0}
    cycle.parameters.controller.drift = None
    assert status.dead_time(cycle) is None
