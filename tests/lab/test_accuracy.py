"""``make accuracy``: work is kept, never taken for another's, and the page's own text stays."""

import json
from pathlib import Path
from typing import cast

import pytest

from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.simulators.lab import accuracy
from linemate.simulators.lab.accuracy import BEGIN, END, WorkPlace, groups, write
from linemate.simulators.lab.cases import CASES, Case

SHORT = ("scenario.lead_in_s=1.3", "scenario.duration_s=0.1")


def test_text_around_the_tables_stays(tmp_path: Path) -> None:
    page = tmp_path / "docs" / "accuracy.md"
    write(page, "first")
    assert page.read_text() == f"# Accuracy\n\n{BEGIN}\nfirst\n{END}\n"
    page.write_text(f"# Title\n\nbefore\n\n{BEGIN}\nfirst\n{END}\n\nafter\n")
    write(page, "second")
    assert page.read_text() == f"# Title\n\nbefore\n\n{BEGIN}\nsecond\n{END}\n\nafter\n"


def test_a_page_without_marks_gets_them_at_its_end(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Title\n\nwords\n")
    write(page, "tables")
    assert page.read_text() == f"# Title\n\nwords\n\n{BEGIN}\ntables\n{END}\n"


def test_groups_are_cut_to_what_is_asked_for() -> None:
    assert groups(CASES["wheel"], 2) == {"tuned": range(2), "verify": range(1000, 1002)}
    whole = groups(CASES["wheel"], 1000)
    assert whole == {"tuned": range(40), "verify": range(1000, 1200)}
    assert groups(CASES["servo-0.9"], 1000) == {"verify": range(1000, 1200)}
    assert groups(CASES["bank"], 1000) == {"verify": range(1000, 1040)}


def test_work_is_kept_for_the_same_sources_and_question_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accuracy, "digest", lambda: "a")
    count = 0

    def make() -> list[int]:
        nonlocal count
        count += 1
        return [count]

    def piece(asked: object, sources: str = "a") -> object:
        return accuracy._piece(WorkPlace(tmp_path, sources), "piece", asked, make)

    assert piece(1) == piece(1) == [1]
    assert piece(2) == [2]
    (tmp_path / "piece.json").write_text("{")
    assert piece(2) == [3]
    # Somebody edits a source while the piece is made: it is no one's result.
    with pytest.raises(accuracy.ChangedError, match="piece"):
        piece(2, sources="b")


def test_the_page_is_written_from_real_runs_and_kept_work_makes_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Others may be editing this checkout while its tests run.
    monkeypatch.setattr(accuracy, "digest", lambda: "a")
    short = Case("cut short", variant="oracle", sets=SHORT)
    monkeypatch.setitem(cast(dict[str, Case], CASES), "oracle", short)
    page = tmp_path / "page.md"
    arguments = ["--cases", "oracle", "--detection", "", "--seeds", "1", "--workers", "1"]
    arguments += ["--page", str(page), "--kept", str(tmp_path / "kept")]
    assert accuracy.main(arguments) == 0
    first = page.read_text()
    assert "| cut short | 0 of 1 | 0 of 1 | 0 | 0 |" in first
    assert accuracy.main([*arguments, "--check"]) == 1
    assert page.read_text() == first
    found = json.loads((tmp_path / "kept" / "accuracy.json").read_text())
    assert [run["seed"] for run in found["runs"]["oracle"]["verify"]] == [1000]


def test_the_default_is_not_run_twice_under_two_names() -> None:
    plan = accuracy._plan(accuracy._parser().parse_args([]))
    kind = TrackingSettings().classifier.value
    assert kind not in plan.cases
    assert f"12 {kind}" not in plan.sources
    assert {"wheel", "oracle", "rule", "imm"} <= set(plan.cases) | {kind}
    assert {"12 default", "4 default", "12 rule"} <= set(plan.sources)


def test_a_case_has_its_own_seeds_and_a_detection_run_its_own_hours() -> None:
    arguments = ["--cases", "oracle:3,rule", "--detection", "12 rule:0.5", "--seeds", "7"]
    plan = accuracy._plan(accuracy._parser().parse_args(arguments))
    assert (plan.cases, plan.sources) == (("oracle", "rule"), ("12 rule",))
    assert (plan.seeds, plan.own) == (7, {"oracle": 3.0, "12 rule": 0.5})


@pytest.mark.parametrize(
    "arguments",
    [
        ["--cases", "luck"],
        ["--detection", "luck"],
        ["--overlay", "/nowhere/overlay.yaml"],
        ["--seeds", "0"],
        ["--cases", "oracle:few"],
        ["--detection", "12 default:0"],
        ["--hours", "nan"],
    ],
)
def test_what_there_is_not_ends_with_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert accuracy.main(arguments) == 2
    assert "accuracy: " in capsys.readouterr().err
