"""Campaigns: the same whatever the number of workers, and summed up as they should be."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from linemate.simulators.harness import setup
from linemate.simulators.harness.main import main
from linemate.simulators.lab import campaign
from linemate.simulators.lab.campaign import CampaignJob

SHORT = ("scenario.lead_in_s=1.3", "scenario.duration_s=0.1")


def jobs(out: Path | None = None) -> list[CampaignJob]:
    made = [setup.make("wheel", SHORT, variant=name) for name in ("default", "no-damping")]
    return [CampaignJob(one, seed, out) for one in made for seed in (0, 1)]


def test_the_number_of_workers_does_not_show() -> None:
    alone = campaign.execute(jobs(), workers=1)
    together = campaign.execute(jobs(), workers=2)
    assert json.dumps(alone) == json.dumps(together)
    assert [(r["variant"], r["seed"]) for r in alone] == [
        ("default", 0), ("default", 1), ("no-damping", 0), ("no-damping", 1)
    ]  # fmt: skip


def children_of(parent: int) -> set[int]:
    listed = Path(f"/proc/{parent}/task/{parent}/children")
    return {int(pid) for pid in listed.read_text().split()}


def test_workers_do_not_outlive_a_campaign_that_is_killed() -> None:
    program = (
        "import time, sys; from linemate.simulators.lab import worker_pool\n"
        "if __name__ == '__main__': worker_pool.spread(time.sleep, [600, 600], 2)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as parent:
        workers: set[int] = set()
        deadline = time.monotonic() + 60.0
        try:
            while len(workers) < 3:  # two, and what keeps track of their semaphores
                assert time.monotonic() < deadline
                assert parent.poll() is None
                time.sleep(0.02)
                workers = children_of(parent.pid)
            time.sleep(0.5)
        finally:
            parent.kill()
    while any(Path(f"/proc/{pid}/exe").exists() for pid in workers):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_progress_is_reported_once_a_run() -> None:
    count = 0

    def progress() -> None:
        nonlocal count
        count += 1

    campaign.execute(jobs()[:2], workers=1, progress=progress)
    assert count == 2


def test_a_campaign_prints_runs_and_a_summary_for_each_variant(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    arguments = ["campaign", "--seeds", "2", "--first-seed", "5", "--json", "--workers", "1"]
    arguments += ["--variants", "default,no-damping", "--out", str(tmp_path)]
    arguments += [part for override in SHORT for part in ("--set", override)]
    assert main(arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "campaign.json").read_text())
    assert [run["seed"] for run in printed["runs"]] == [5, 6, 5, 6]
    assert set(printed["summary"]) == {"default", "no-damping"}
    figure = printed["summary"]["default"]["limits.violations"]
    assert set(figure) == {"median", "worst", "worst_seed", "ci95", "n"}


def test_the_table_tells_every_variant(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["campaign", "--seeds", "1", "--workers", "1", "--variants", "default,rule"]
    arguments += [part for override in SHORT for part in ("--set", override)]
    assert main(arguments) == 0
    head = capsys.readouterr().out.splitlines()[0].split()
    assert head == ["figure", "default", "rule"]


def test_a_run_that_does_not_assemble_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "--json", *(p for o in SHORT for p in ("--set", o))]
    assert main(arguments) == 1
    first = capsys.readouterr().out
    assert main(arguments) == 1
    assert capsys.readouterr().out == first
    assert json.loads(first)["assembled"] is False


def test_a_run_leaves_its_report(tmp_path: Path) -> None:
    main(["run", "--out", str(tmp_path), "--set", "scenario.duration_s=2.0"])
    left = {path.name for path in tmp_path.iterdir()}
    assert {"result.json", "report.html", "fig4.png", "fig5.png"} <= left


def test_several_seeds_are_reported_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "--seed", "0..1", "--workers", "1"]
    arguments += [part for override in SHORT for part in ("--set", override)]
    assert main(arguments) == 1
    assert "2 runs, 0 assembled within limits" in capsys.readouterr().out
