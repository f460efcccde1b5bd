"""Production in the process: what operators may order, and what they are answered."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from linemate.daemon.config import config, files
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.service.app import App
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.notify import Notifier
from linemate.daemon.service.production.production_cell import ProductionCell

STATION = """
task: wheel.yaml
rsi: {port: 0}
command: {socket: c.sock}
production:
  variants: {sedan: wheel.yaml, wagon: wheel.yaml}
  records: .
"""


@pytest.fixture
def app(tmp_path: Path, parameters: Parameters) -> App:
    path = tmp_path / "linemated.yaml"
    path.write_text(STATION)
    variants = {"sedan": parameters, "wagon": parameters}
    return App(config.load(path), parameters, realtime.RealtimeHost(), Notifier(), variants)


def ask(app: App, op: str, who: str = "plc", **params: Any) -> Mapping[str, Any]:
    async def body() -> Any:
        answer = app._handle(op, params, "operate", who)
        return await answer if isinstance(answer, asyncio.Future) else answer

    answer: Mapping[str, Any] = asyncio.run(body())
    return answer


def cell(app: App) -> ProductionCell:
    assert app._production is not None
    return app._production


def test_a_part_is_announced_with_its_distance_or_refused_without_a_reading(app: App) -> None:
    refused = ask(app, "announce", part="P1", variant="sedan")
    assert "the distance sensor has given no reading" in refused["refused"]
    assert ask(app, "announce", part="P1", variant="sedan", distance=3.0)["waiting"] == 1
    app.cycle.samples.reading = 4.5
    assert ask(app, "announce", part="P2", variant="wagon")["waiting"] == 2
    shown = ask(app, "queue")
    assert [each["part"] for each in shown["queue"]] == ["P1", "P2"]
    assert [each["position"] for each in shown["queue"]] == pytest.approx([-1.5, -3.0])


def test_by_hand_is_refused_while_production_runs(app: App) -> None:
    ask(app, "next")
    assert ask(app, "arm")["refused"] == "production runs. Order hold first."
    assert ask(app, "hold", "uid:1000")["held"] == "hold ordered by uid:1000"
    assert "production" not in ask(app, "arm")["refused"]


@pytest.mark.parametrize("op", ["stop", "retreat"])
def test_a_stop_by_anybody_puts_production_on_hold_before_its_answer(app: App, op: str) -> None:
    ask(app, "next")
    assert cell(app).status()["held"] is None
    app._handle(op, {}, "operate", "uid:7") if op == "retreat" else ask(app, op, "uid:7")
    assert cell(app).status()["held"] == f"{op} ordered by uid:7"


def test_the_status_has_production_only_where_it_is_configured(
    app: App, tmp_path: Path, parameters: Parameters
) -> None:
    assert app.status()["production"]["variants"] == ["sedan", "wagon"]
    path = tmp_path / "plain.yaml"
    path.write_text("task: wheel.yaml\nrsi: {port: 0}\ncommand: {socket: d.sock}\n")
    plain = App(config.load(path), parameters, realtime.RealtimeHost(), Notifier())
    assert "production" not in plain.status()
    assert "no such operation" in ask(plain, "queue")["refused"]


def test_a_parameter_that_needs_the_compiler_is_refused_with_variants(app: App) -> None:
    answer = ask(app, "set", values={"control.horizon_s": 0.6})
    assert "changes only with a restart" in answer["refused"]


def test_a_new_tuning_is_used_by_every_variant(app: App) -> None:
    assert "changed" in ask(app, "set", values={"tracking.camera.lateral": 3e-4})
    tuned = {c.tracker.settings.camera.lateral for c in cell(app)._variants.values()}
    assert tuned == {3e-4}


@pytest.mark.parametrize(
    ("window", "what"),
    [
        ("{start: 0.0, latest_start: -1.0}", "production.window.start: 0 m is not before"),
        ("{latest_start: 1.0, abort: 0.5}", "production.window.abort: 0.5 m is not behind"),
        ("{start: -9.0, latest_start: -5.0}", "production.announced_at: -3 m is beyond"),
    ],
)
def test_a_window_out_of_order_is_refused_at_start(tmp_path: Path, window: str, what: str) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text(STATION + f"  window: {window}\n")
    with pytest.raises(config.FileError) as refused:
        config.load(path)
    assert what in refused.value.lines[0]


def test_every_variants_file_is_read_at_start_and_has_the_same_arm(tmp_path: Path) -> None:
    path = tmp_path / "linemated.yaml"
    path.write_text(STATION.replace("wagon: wheel.yaml", "wagon: none.yaml"))
    with pytest.raises(config.FileError, match=r"production.variants.wagon"):
        config.load(path)
    other = (files.DAEMON_DATA / "wheel.yaml").read_text()
    (tmp_path / "other.yaml").write_text(other.replace("linear_axis: true", "linear_axis: false"))
    path.write_text(STATION.replace("wagon: wheel.yaml", "wagon: other.yaml"))
    with pytest.raises(config.FileError, match="its arm differs"):
        config.load(path)
