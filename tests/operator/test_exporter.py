"""Metrics: judged by Prometheus' own parser, asked over real HTTP of a real daemon."""

import http.client
import math
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daemon_process import LINEMATE, DaemonProcess

from linemate.daemon.operator import metrics
from linemate.daemon.operator.exporter import Stations, asked, serve

TEXT = "task: wheel.yaml\nrsi: {port: 0}\ncamera: {port: 0}\ncommand: {socket: c.sock}\n"


def parsed(page: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    parser = pytest.importorskip(
        "prometheus_client.parser", reason="prometheus-client is in the extra dev"
    )
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in parser.text_string_to_metric_families(page)
        for sample in family.samples
    }


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaemonProcess]:
    with DaemonProcess(tmp_path_factory.mktemp("cell"), TEXT) as made:
        yield made


@pytest.fixture(scope="module")
def port(daemon: DaemonProcess) -> Iterator[int]:
    stations = Stations({"west": Path(daemon.listening["command"]["socket"])}, asked)
    with serve(("127.0.0.1", 0), stations) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield int(server.server_address[1])
        server.shutdown()
        thread.join()


def got(port: int, path: str = "/metrics") -> tuple[int, str, str]:
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    link.request("GET", path)
    answer = link.getresponse()
    return answer.status, answer.headers["Content-Type"], answer.read().decode()


def test_a_scrape_tells_what_the_status_tells(daemon: DaemonProcess, port: int) -> None:
    code, kind, page = got(port)
    assert (code, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
    found = parsed(page)
    west = ("station", "west")
    status = daemon.status()
    assert found["linemate_up", frozenset({west})] == 1.0
    assert found["linemate_state", frozenset({west, ("state", "init")})] == 1.0
    assert sum(v for (name, _), v in found.items() if name == "linemate_state") == 1.0
    assert found["linemate_health", frozenset({west, ("health", status["health"])})] == 1.0
    for link, told in status["links"].items():
        assert found["linemate_link_up", frozenset({west, ("link", link)})] == told["up"]
    for kind in status["telegrams"]:
        assert ("linemate_telegrams_total", frozenset({west, ("kind", kind)})) in found
    assert all(math.isfinite(value) for value in found.values())


def test_another_path_and_another_method_are_refused_and_the_next_scrape_is_served(
    port: int,
) -> None:
    assert got(port, "/")[0] == 404
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    link.request("POST", "/metrics", body=b"x" * 1000)
    assert link.getresponse().status == 501
    with socket.create_connection(("127.0.0.1", port)) as rude:
        rude.sendall(b"\xff" * 200)
    assert got(port)[0] == 200


def test_a_client_that_says_nothing_holds_the_page_up_for_two_seconds_at_most(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port)):
        assert got(port)[0] == 200


def test_however_often_it_is_asked_it_asks_the_daemon_once_a_second() -> None:
    now, times = [0.0], []

    def ask(path: Path) -> dict[str, Any]:
        times.append(now[0])
        return {}

    stations = Stations({"a": Path("a")}, ask, lambda: now[0])
    for now[0] in (0.0, 0.3, 0.9, 1.0, 1.5, 2.5):
        stations.statuses()
    assert times == [0.0, 1.0, 2.5]


def test_what_is_no_number_is_left_out_and_odd_names_are_escaped() -> None:
    status = {
        "health": 'a"b\\c\nd',
        "steps": math.nan,
        "late": None,
        "faults": "many",
        "links": {'x"\n\\': {"up": True, "age_s": math.inf, "counters": {"lost": 2}}},
    }
    found = parsed(metrics.text({'we"st\n': status, "east": None}))
    west = ("station", 'we"st\n')
    assert found["linemate_link_up", frozenset({west, ("link", 'x"\n\\')})] == 1.0
    assert found["linemate_up", frozenset({("station", "east")})] == 0.0
    names = {name for name, _ in found}
    unwanted = {"linemate_steps_total", "linemate_late_total", "linemate_faults_total"}
    assert not names & (unwanted | {"linemate_link_age_seconds"})


def test_the_tool_prints_a_page_and_refuses_to_be_reached_by_others(daemon: DaemonProcess) -> None:
    where = f"west={daemon.listening['command']['socket']}"
    once = subprocess.run(
        [*LINEMATE, "metrics", "--once", "--station", where],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ("linemate_up", frozenset({("station", "west")})) in parsed(once.stdout)
    nobody = [*LINEMATE, "metrics", "--once", "--station", "x=/nobody"]
    assert subprocess.run(nobody, capture_output=True, check=False).returncode == 3
    open_to_all = subprocess.run(
        [*LINEMATE, "metrics", "--listen", "0.0.0.0:0"], capture_output=True, text=True, check=False
    )
    assert open_to_all.returncode == 1
    assert open_to_all.stderr.count("\n") == 1
