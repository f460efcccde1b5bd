"""Runs on a dask cluster: the same results, and a clear word when there is none."""

import json
import sys
from collections.abc import Iterator

import pytest

from linemate.simulators.harness import cluster, setup
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.cluster import ClusterError
from linemate.simulators.harness.main import main
from linemate.simulators.lab import campaign
from linemate.simulators.lab.campaign import CampaignJob

SHORT = ("scenario.lead_in_s=1.3", "scenario.duration_s=0.1")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=2, dashboard_address=None, host="127.0.0.1"
    ) as made:
        yield made.scheduler_address


def jobs() -> list[CampaignJob]:
    made = [setup.make("wheel", SHORT, variant=name) for name in ("default", "oracle")]
    return [CampaignJob(one, seed) for one in made for seed in (0, 1)]


def test_a_cluster_gives_the_results_of_this_process_in_the_same_order(address: str) -> None:
    calls = 0

    def progress() -> None:
        nonlocal calls
        calls += 1

    there = campaign.execute(jobs(), progress=progress, scheduler=address)
    assert calls == 4
    assert json.dumps(there) == json.dumps(campaign.execute(jobs(), workers=1))


def test_a_campaign_takes_the_schedulers_address(
    address: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["campaign", "--seeds", "1", "--json", "--scheduler", address]
    arguments += [part for override in SHORT for part in ("--set", override)]
    assert main(arguments) == 0
    assert [run["seed"] for run in json.loads(capsys.readouterr().out)["runs"]] == [0]


def test_what_a_job_refuses_is_refused_here(address: str) -> None:
    bad = setup.make("wheel", ("task.arm.flange=no_such_frame",))
    with pytest.raises(SetupError, match="no_such_frame"):
        campaign.execute([CampaignJob(bad, 0)], scheduler=address)


def test_workers_with_other_sources_are_refused(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "SUFFIXES", (".yaml",))
    with pytest.raises(ClusterError, match="other sources"):
        campaign.execute(jobs(), scheduler=address)


def test_an_address_where_no_one_answers_ends_with_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "CONNECT_S", 0.2)
    assert main(["campaign", "--seeds", "1", "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "no scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_without_dask_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["campaign", "--seeds", "1", "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "linemate[cluster]" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["cluster", "127.0.0.1:8786", "http://127.0.0.1", "tcp://"])
def test_what_is_no_address_is_wrong_usage(text: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["campaign", "--scheduler", text])
    assert caught.value.code == 2


def test_the_digest_knows_sources_and_shipped_files() -> None:
    names = [name for name, _ in cluster._sources()]
    assert {"daemon/core/step.py", "daemon/data/wheel.yaml", "protocol/rsi/codec.py"} <= set(names)
    assert cluster.digest() == cluster.digest()
