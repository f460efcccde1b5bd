"""A report shows what the rows say, and says it without any other file."""

import base64
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from linemate.simulators.judge import figures, report, table
from linemate.simulators.judge.rows import CLAMPED, FREE, Rows, empty

T0 = 0.012


def quaternion_product(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        axis=-1,
    )


def about(vector: NDArray[Any]) -> NDArray[Any]:
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    axis = vector / np.where(angle < 1e-12, 1.0, angle)
    return np.concatenate((np.cos(angle / 2), np.sin(angle / 2) * axis), axis=-1)


def unit_motion(time: NDArray[Any]) -> NDArray[Any]:
    stopping = np.clip(time - 5.0, 0.0, 0.106 / 0.104)
    starting = np.clip(time - 9.0, 0.0, 0.106 / 0.013)
    speed = 0.106 - 0.104 * stopping + 0.013 * starting
    return np.asarray(np.cumsum(speed) * T0)


def poses(time: NDArray[Any], shift: NDArray[Any], turn: NDArray[Any]) -> NDArray[Any]:
    """Poses in base from shift (N, 3) m and rotation vector (N, 3) rad in the conveyor's frame."""
    nominal = np.array((np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0))
    position = figures.NOMINAL_POSITION + shift @ figures.NOMINAL_ROTATION.T
    quaternion = quaternion_product(np.broadcast_to(nominal, (len(time), 4)), about(turn))
    return np.concatenate((position, quaternion), axis=1)


@pytest.fixture(scope="module")
def rows() -> Rows:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 18.0, T0)
    unit = unit_motion(time)
    blend = np.clip(time / 1.5, 0.0, 1.0)[:, None] ** 2
    away = -0.35 * np.clip((6.0 - time) / 5.0, 0.0, 1.0) - 0.25 * np.clip(
        (time - 15.0) / 2.0, 0.0, 1.0
    )
    swing = 0.008 * np.exp(-0.05 * time) * np.cos(2 * np.pi * 0.62 * time)
    offset = np.array((0.045, -0.06, 0.03))
    hub_shift = np.stack((-0.3 * swing, unit, -0.9 * swing), axis=1) + offset
    sensed_shift = hub_shift + np.stack((0 * time, 0 * time, away), axis=1)
    turn = np.array((0.12, 0.25, -0.28)) + np.stack((0 * time, swing, 0 * time), axis=1)
    turn[time > 9.5] += (0.0012, -0.0015, 0.0)
    target_shift = blend * sensed_shift + (1 - blend) * np.array((0.0, 0.0, -0.35))
    error = 2e-4 * np.sin(2 * np.pi * 3 * time)[:, None] * np.array((1.0, 2.0, -1.0))
    noise = 2e-4 * rng.standard_normal((len(time), 3))
    sensed = poses(time, sensed_shift + noise, turn)
    sensed[time < 0.4] = np.nan
    phase = np.select([time < 0.5, time < 6.0, time < 15.0], [1, 2, 3], 5)
    tcp = poses(time, target_shift + error, blend * turn)
    pressed = poses(time, target_shift + 2 * error, blend * turn)
    found = empty(len(time))
    return replace(
        found,
        t=time,
        target=poses(time, target_shift, blend * turn),
        sensed=sensed,
        part=poses(time, hub_shift + noise, turn),
        tcp=tcp,
        tcp_rigid=pressed,
        hub=poses(time, hub_shift, turn),
        contact=np.where((time >= 6.0) & (time < 15.0), CLAMPED, FREE),
        unit_position=unit,
        phase=phase,
    )


RESULT: dict[str, Any] = {
    "version": 1,
    "scenario": "paper",
    "seed": 3,
    "cycle_ms": 12,
    "assembled": True,
    "outcome": "assembled",
    "duration_s": 18.0,
    "control_error": {"approach": {"max_mm": 0.061, "rms_mm": 0.02, "max_mrad": 0.11}},
    "total_error": {"impact": {"max_mm": 0.4, "rms_mm": None, "max_mrad": 0.2}},
    "detection": [
        {"event": "stop", "onset_s": 5.0, "perceived_s": 0.16, "confirmed_s": 0.28},
        {"event": "start", "onset_s": 9.0, "perceived_s": 1.5, "confirmed_s": None},
    ],
    "false_alarms": {"tentative": 2, "confirmed": 0},
    "telegrams": {"sent": 1500, "answered": 1500, "late": 0, "lost": 0, "refused": 0},
    "step_us": {"p50": 300.0, "p99": 512.0, "max": 900.0},
    "limits": {"violations": 0},
    "notes": ["no real-time rights: <b>priority</b> stays ordinary"],
}


def test_the_page_needs_no_other_file(rows: Rows, tmp_path: Path) -> None:
    files = report.write(tmp_path / "out", RESULT, rows)
    assert [file.name for file in files] == ["fig4.png", "fig5.png", "report.html"]
    page = files[-1].read_text(encoding="utf-8")
    assert "src=" in page
    assert all(source.startswith("data:image/png") for source in re.findall(r'src="([^"]*)', page))
    assert not re.search(r"(https?:)?//[a-z]", page.split("<body>")[0])
    assert "<script" not in page
    embedded = re.findall(r"base64,([A-Za-z0-9+/=]+)", page)
    assert base64.b64decode(embedded[0]) == files[0].read_bytes()
    assert base64.b64decode(embedded[1]) == files[1].read_bytes()


def test_the_page_tells_every_figure_of_the_result_and_escapes_words() -> None:
    page = report.page(RESULT, {})
    for figure in ("0.061", "0.110", "0.160", "0.280", "1500", "512"):
        assert f">{figure}<" in page
    assert "<b>priority" not in page
    assert "&lt;b&gt;priority" in page


def test_a_failed_run_is_not_dressed_up() -> None:
    failed = RESULT | {"assembled": False, "outcome": "collision"}
    assert "NOT assembled: collision" in table.plain(failed)
    assert 'class="outcome failed"' in report.page(failed, {})
    assert 'class="outcome failed"' not in report.page(RESULT, {})


def test_what_is_not_known_is_a_dash_and_never_a_zero() -> None:
    text = table.plain(RESULT)
    start = next(line for line in text.splitlines() if line.strip().startswith("start"))
    assert start.split()[-1] == table.DASH
    assert table.number(float("nan")) == table.DASH
    assert table.number(0) == "0"
    assert table.number(0.0, 1) == "0.0"
    assert table.plain({}).startswith("NOT assembled")


def test_figures_are_pictures_of_a_readable_size_with_ink(rows: Rows) -> None:
    drawings = (figures.trajectories, figures.control_error, figures.errors_apart)
    for draw in drawings:
        picture = imread(io.BytesIO(report.png(draw(rows, RESULT))))
        height, width = picture.shape[:2]
        assert width >= 1200
        assert height >= 500
        ink = float(np.mean(picture[..., :3].min(axis=2) < 0.9))
        assert 0.005 < ink < 0.3


def test_the_same_rows_give_the_same_bytes(rows: Rows) -> None:
    once, again = (report.png(figures.control_error(rows, RESULT)) for _ in range(2))
    assert once == again


def test_a_known_deviation_is_found_again() -> None:
    time = np.arange(5.0)
    turn = np.array((0.1, -0.3, 0.2)) * (time[:, None] - 2.0) / 2.0
    shift = np.stack((0.01 * time, -0.02 * time, 0.03 + 0 * time), axis=1)
    found_shift, found_turn = figures.from_nominal(poses(time, shift, turn))
    assert found_shift == pytest.approx(shift, abs=1e-12)
    assert found_turn == pytest.approx(turn, abs=1e-12)
    moved = poses(time, shift, turn)
    zero_shift, zero_turn = figures.deviation(moved, moved)
    assert zero_shift == pytest.approx(0.0, abs=1e-12)
    assert zero_turn == pytest.approx(0.0, abs=1e-12)


def test_figure_five_draws_the_error_of_the_true_tcp_against_the_committed_pose(rows: Rows) -> None:
    axes = figures.control_error(rows, RESULT).axes[0]
    drawn = [line.get_ydata() for line in axes.get_lines() if len(line.get_xdata()) == len(rows)]
    norm = np.linalg.norm(np.stack([np.asarray(y) for y in drawn]), axis=0)
    judged = np.where((rows.contact == CLAMPED)[:, None], rows.tcp_rigid, rows.tcp)
    truth = np.linalg.norm(judged[:, :3] - rows.target[:, :3], axis=1)
    assert norm == pytest.approx(1e3 * truth, abs=1e-9)
    assert float(np.max(norm)) > 0.4


def test_figure_four_draws_sensed_dashed_computed_solid_and_conveyor_dash_dotted(
    rows: Rows,
) -> None:
    axes = figures.trajectories(rows, RESULT).axes[0]
    long = [line for line in axes.get_lines() if len(line.get_xdata()) == len(rows)]
    assert [line.get_linestyle() for line in long] == ["-"] * 3 + ["--"] * 3 + ["-."]
    assert np.asarray(long[-1].get_ydata()) == pytest.approx(rows.unit_position)


def test_a_result_survives_json_and_prints_the_same() -> None:
    assert table.plain(json.loads(json.dumps(RESULT))) == table.plain(RESULT)
