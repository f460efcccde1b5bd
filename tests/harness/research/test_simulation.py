"""``linemate.simulate`` and ``linemate.replay``: arrays, truth, own classifiers, recordings."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import own_models
import pytest

import linemate
from linemate.daemon.operator.main import main as operator
from linemate.daemon.recording.format import UnreadableRecordingError
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.research import truth_recording

SHORT = {"scenario.lead_in_s": 1.5, "scenario.duration_s": 0.6}
# The stop of this scenario begins at 5.1 s.
STOP = {"scenario.duration_s": 5.6}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> linemate.Run:
    path = tmp_path_factory.mktemp("runs") / "short.mcap"
    return linemate.simulate(parameters=SHORT, seed=3, record=path)


def test_a_run_has_the_truth_and_the_estimate_in_rows_of_the_same_telegrams(
    recorded: linemate.Run,
) -> None:
    n = len(recorded.t)
    assert n > 100
    assert recorded.truth["hub"].shape == recorded.estimate["part"].shape == (n, 7)
    assert np.allclose(np.linalg.norm(recorded.truth["hub"][:, 3:], axis=1), 1.0)
    seen = np.isfinite(recorded.estimate["part"][:, 0])
    apart = recorded.truth["hub"][seen, :3] - recorded.estimate["part"][seen, :3]
    assert 0.0 < np.abs(apart).max() < 0.02
    columns = recorded.columns()
    assert {values.shape for values in columns.values()} == {(n,)}
    assert np.array_equal(columns["truth.hub.x"], recorded.truth["hub"][:, 0])
    assert np.array_equal(columns["truth.setpoints.e1"], recorded.truth["setpoints"][:, 6])


def test_a_truth_recording_replays_to_the_same_bits_with_its_truth(recorded: linemate.Run) -> None:
    assert recorded.recording is not None
    replayed = linemate.replay(recorded.recording)
    assert replayed.is_identical
    assert replayed.result == recorded.result
    for group in ("truth", "estimate"):
        before, after = getattr(recorded, group), getattr(replayed, group)
        assert before.keys() == after.keys()
        for name in before.keys() - {"step_us"}:
            assert np.array_equal(before[name], after[name], equal_nan=True), name


def test_a_truth_recording_is_the_run(recorded: linemate.Run) -> None:
    plain = linemate.simulate(parameters=SHORT, seed=3)
    assert plain.result == recorded.result
    assert np.array_equal(plain.truth["tcp"], recorded.truth["tcp"])


def test_a_replay_with_another_parameter_differs_and_keeps_the_truth(
    recorded: linemate.Run,
) -> None:
    assert recorded.recording is not None
    changed = linemate.replay(recorded.recording, parameters={"tracking.fusion.speed": 0.005})
    assert changed.is_identical is False
    assert changed.result is None
    assert np.array_equal(changed.truth["hub"], recorded.truth["hub"])
    assert not np.array_equal(changed.estimate["speed"], recorded.estimate["speed"], True)


def test_the_operators_tool_replays_a_simulated_recording(recorded: linemate.Run) -> None:
    assert recorded.recording is not None
    assert operator(["replay", str(recorded.recording)]) == 0


def test_a_recording_of_a_daemon_has_no_truth(
    recorded: linemate.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert recorded.recording is not None
    monkeypatch.setattr(truth_recording, "TRUTH", "another")
    bare = linemate.replay(recorded.recording)
    assert bare.is_identical
    assert not bare.truth
    assert len(bare.t) == len(recorded.t)
    assert np.allclose(np.diff(bare.t), np.diff(recorded.t))
    assert np.allclose(bare.rows.joints[1:], recorded.rows.joints[:-1], atol=1e-6)
    with pytest.raises(ValueError, match="has no truth"):
        bare.errors()


def test_a_damaged_recording_is_refused(recorded: linemate.Run, tmp_path: Path) -> None:
    assert recorded.recording is not None
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.recording.read_bytes()[:-2000])
    with pytest.raises(UnreadableRecordingError, match="damaged"):
        linemate.replay(cut)


def test_an_own_predictor_is_judged_like_a_shipped_variant() -> None:
    own = linemate.simulate(parameters=STOP, classifier=own_models.ConstantSpeed)
    default = linemate.simulate(parameters=STOP)
    assert own.result is not None
    assert default.result is not None
    assert own.result["variant"] == "ConstantSpeed"
    for run in (own, default):
        assert run.result is not None
        assert run.result["limits"]["violations"] == 0
    # Without a class the prediction misses the braking conveyor by 0.5 a t^2.
    stop = {id(run): run.result["plan_error"]["stop"]["max_mm"] for run in (own, default)}
    assert stop[id(own)] > 1.3 * stop[id(default)]


def test_an_own_predictor_can_be_replayed_on_a_recording(recorded: linemate.Run) -> None:
    assert recorded.recording is not None
    place = f"{own_models.__name__}:ConstantSpeed"
    own = linemate.replay(recorded.recording, classifier=place)
    assert own.is_identical is False
    # The estimate is not the predictor's.
    assert np.array_equal(own.estimate["speed"], recorded.estimate["speed"], equal_nan=True)


@pytest.mark.parametrize(
    ("classifier", "message"),
    [
        ("luck", "no variant 'luck'"),
        ("own_models:Nothing", "Nothing"),
        ("no_such_module:Thing", "no_such_module"),
        (own_models.TakesNothing, "TakesNothing"),
    ],
    ids=str,
)
def test_a_classifier_that_cannot_be_used_is_refused(classifier: object, message: str) -> None:
    with pytest.raises(SetupError, match=message):
        linemate.simulate(parameters=SHORT, classifier=classifier)  # type: ignore[arg-type]


def test_a_replay_takes_no_variant(recorded: linemate.Run) -> None:
    assert recorded.recording is not None
    with pytest.raises(linemate.PluginError, match="variant of simulated runs"):
        linemate.replay(recorded.recording, classifier="no-damping")


def test_a_predictor_without_numbers_stops_the_run_with_its_name() -> None:
    with pytest.raises(linemate.PluginError, match=r"NotANumber.predict_positions"):
        linemate.simulate(parameters=SHORT, classifier=own_models.NotANumber)


def test_another_task_file_is_run(tmp_path: Path) -> None:
    shipped = Path(linemate.__file__).parent / "daemon/data/wheel.yaml"
    text = shipped.read_text(encoding="utf-8")
    (tmp_path / "slow.yaml").write_text(text, encoding="utf-8")
    run = linemate.simulate(tmp_path / "slow.yaml", parameters=SHORT, seed=3)
    assert np.array_equal(
        run.truth["tcp"], linemate.simulate(parameters=SHORT, seed=3).truth["tcp"]
    )


def test_importing_linemate_loads_nothing_heavy() -> None:
    code = "import linemate, sys; print('numpy' in sys.modules, sorted(linemate.__all__)[0])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "Classifier"]


def test_every_public_name_can_be_imported() -> None:
    for name in linemate.__all__:
        assert getattr(linemate, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'luck'"):
        _ = linemate.luck
