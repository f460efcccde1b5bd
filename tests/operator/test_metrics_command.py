"""Metrics: judged by Prometheus' own parser, asked over real HTTP of a real daemon."""

import contextlib
import http.client
import itertools
import math
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daemon_process import LINEMATE, DaemonProcess

from linemate.daemon.cycle.clock.timing import Timing
from linemate.daemon.operator import metrics_page
from linemate.daemon.operator.metrics_command import REQUEST_S, Stations

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


@contextlib.contextmanager
def serving(daemon: DaemonProcess, *names: str, host: str = "127.0.0.1") -> Iterator[int]:
    """The page of a daemon, by `linemate metrics` as a process of its own; its port."""
    where = f"west={daemon.listening['command']['socket']}"
    hosts = [word for name in names for word in ("--host", name)]
    remote = [] if host == "127.0.0.1" else ["--allow-remote"]
    command = [*LINEMATE, "metrics", "--listen", f"{host}:0", "--station", where, *hosts, *remote]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline()
            yield int(address.rsplit(":", 1)[1].partition("/")[0])
        finally:
            process.kill()


@pytest.fixture(scope="module")
def port(daemon: DaemonProcess) -> Iterator[int]:
    with serving(daemon) as made:
        yield made


def got(port: int, path: str = "/metrics") -> tuple[int, str, str]:
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    link.request("GET", path)
    answer = link.getresponse()
    return answer.status, answer.headers["Content-Type"], answer.read().decode()


def test_a_scrape_has_the_numbers_of_the_status(daemon: DaemonProcess, port: int) -> None:
    code, kind, page = got(port)
    assert (code, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
    found = parsed(page)
    west = ("station", "west")
    status = daemon.status()
    assert found["linemate_up", frozenset({west})] == 1.0
    assert found["linemate_state", frozenset({west, ("state", "init")})] == 1.0
    assert sum(v for (name, _), v in found.items() if name == "linemate_state") == 1.0
    assert found["linemate_health", frozenset({west, ("health", status["health"])})] == 1.0
    for name, link in status["links"].items():
        assert found["linemate_link_up", frozenset({west, ("link", name)})] == link["up"]
    for kind in status["telegrams"]:
        assert ("linemate_telegrams_total", frozenset({west, ("kind", kind)})) in found
    assert all(math.isfinite(value) for value in found.values())


def test_another_path_and_another_method_are_refused_and_the_next_scrape_is_served(
    port: int,
) -> None:
    assert got(port, "/")[0] == 404
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    link.request("POST", "/metrics", body=b"x" * 1000)
    assert link.getresponse().status == 400
    with socket.create_connection(("127.0.0.1", port)) as rude:
        rude.sendall(b"\xff" * 200)
    assert got(port)[0] == 200


def asked_as(port: int, host: str) -> int:
    """The status of an answer to a request in another name."""
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    link.putrequest("GET", "/metrics", skip_host=True)
    link.putheader("Host", host)
    link.endheaders()
    return link.getresponse().status


def test_slow_clients_do_not_stop_a_scrape_and_are_dropped(port: int) -> None:
    with contextlib.ExitStack() as stack:
        slow = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(10)
        ]
        deadline = time.monotonic() + 3 * REQUEST_S
        dropped = 0
        # A byte now and then renews no time-out.
        for k, client in itertools.cycle(enumerate(slow)):
            with contextlib.suppress(OSError):
                client.send(b"G")
            if k == len(slow) - 1:
                began = time.monotonic()
                assert got(port)[0] == 200
                assert time.monotonic() - began < REQUEST_S / 2
                time.sleep(REQUEST_S / 10)
                dropped = sum(is_dropped(one) for one in slow)
            if dropped == len(slow) or time.monotonic() > deadline:
                break
        assert dropped == len(slow)


def is_dropped(client: socket.socket) -> bool:
    client.setblocking(False)
    try:
        return client.recv(100) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def test_a_client_that_does_not_read_stops_no_scrape(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port)) as deaf:
        deaf.sendall(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")
        for _ in range(3):
            assert got(port)[0] == 200


def test_a_request_in_the_name_of_another_host_is_refused(port: int, daemon: DaemonProcess) -> None:
    for host in ("localhost", f"localhost:{port}", f"127.0.0.1:{port}"):
        assert asked_as(port, host) == 200
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", ""):
        assert asked_as(port, host) == 421
    with serving(daemon, "Cell-1.plant", host="0.0.0.0") as remote:
        assert asked_as(remote, f"cell-1.plant:{remote}") == 200
        assert asked_as(remote, f"192.0.2.7:{remote}") == 200
        assert asked_as(remote, "evil.example") == 421


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
    found = parsed(metrics_page.text({'we"st\n': status, "east": None}))
    west = ("station", 'we"st\n')
    assert found["linemate_link_up", frozenset({west, ("link", 'x"\n\\')})] == 1.0
    assert found["linemate_up", frozenset({("station", "east")})] == 0.0
    names = {name for name, _ in found}
    unwanted = {"linemate_steps_total", "linemate_late_total", "linemate_faults_total"}
    assert not names & (unwanted | {"linemate_link_age_seconds"})


ABBREVIATED = {"s", "ms", "us", "ns", "sec", "min", "h", "d", "m", "mm", "hz", "b", "kb", "mb"}
SCALED = re.compile(r"(milli|micro|nano|kilo|mega|minute|hour|day|percent)")
TYPES = {"counter", "gauge", "histogram", "summary"}


def complaints_of(page: str) -> list[str]:
    """What ``promtool check metrics`` would say, by the rules of its documentation."""
    found = []
    kinds = dict(re.findall(r"^# TYPE (\S+) (\S+)$", page, re.MULTILINE))
    helped = set(re.findall(r"^# HELP (\S+) \S", page, re.MULTILINE))
    for name, kind in kinds.items():
        words = set(name.split("_"))
        found += [f"{name}: no help"] if name not in helped else []
        found += (
            [f"{name}: counter without _total"]
            if ((kind == "counter") != name.endswith("_total"))
            else []
        )
        found += [f"{name}: unit"] if words & ABBREVIATED or SCALED.search(name) else []
        found += [f"{name}: type in its name"] if words & TYPES else []
        found += [f"{name}: no snake case"] if not re.fullmatch("[a-z][a-z0-9_]*", name) else []
    for name, label in re.findall(r"^(\w+)\{[^}]*\b(quantile|le)=", page, re.MULTILINE):
        kind = kinds.get(name.removesuffix("_bucket"))
        if kind != {"quantile": "summary", "le": "histogram"}[label]:
            found.append(f"{name}: {label}")
    return found


def timed_status() -> dict[str, Any]:
    timing = Timing(12_000_000)
    for i in range(1, 1001):
        timing.turnaround.add(1_000 * i)
        timing.step.add(16_384 if i % 2 else 16_383)
    return {**timing.summary(), "clock": {"period_ms": 11.98}}


def test_the_page_keeps_prometheus_rules_for_names_units_and_types(daemon: DaemonProcess) -> None:
    for status in (timed_status(), daemon.status()):
        assert not complaints_of(metrics_page.text({"west": status}))
    old = "# HELP linemate_x_milliseconds X.\n# TYPE linemate_x_milliseconds gauge\n"
    old += 'linemate_x_milliseconds{quantile="1"} 2\n'
    assert len(complaints_of(old)) == 2


def promtool_complaints(page: str) -> list[str]:
    """What Prometheus' own linter says of a page."""
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("no promtool here; Debian has it in the package prometheus")
    command = [tool, "check", "metrics"]
    answer = subprocess.run(command, input=page, capture_output=True, text=True, check=False)
    complaints = answer.stderr.splitlines()
    assert answer.returncode == (3 if complaints else 0)
    return complaints


def test_prometheus_own_linter_has_no_complaint(daemon: DaemonProcess) -> None:
    sensors = {"camera": {"out": "frozen", "refused": 3}}
    recording = {"recording": True, "written": 7, "dropped": 0, "restarts": 1}
    whole = {**daemon.status(), **timed_status(), "sensors": sensors, "recording": recording}
    assert not promtool_complaints(metrics_page.text({"west": whole, "east": daemon.status()}))
    old = "# HELP linemate_x_milliseconds X.\n# TYPE linemate_x_milliseconds gauge\n"
    old += 'linemate_x_milliseconds{quantile="1"} 2\n'
    assert len(promtool_complaints(old)) == 2


def test_histograms_count_every_duration_once_and_never_fall() -> None:
    found = parsed(metrics_page.text({"west": timed_status()}))
    west = ("station", "west")
    for name in ("turnaround", "step", "wakeup", "lead"):
        family = f"linemate_{name}_time_seconds"
        buckets = {
            float(dict(labels)["le"]): value
            for (each, labels), value in found.items()
            if each == f"{family}_bucket"
        }
        counts = [buckets[edge] for edge in sorted(buckets)]
        assert counts == sorted(counts)
        assert buckets[math.inf] == found[f"{family}_count", frozenset({west})]
        assert len(buckets) == 15
    turnaround = "linemate_turnaround_time_seconds"
    assert found[f"{turnaround}_count", frozenset({west})] == 1000.0
    assert found[f"{turnaround}_sum", frozenset({west})] == pytest.approx(0.5005)
    # 65 of the durations are at most 65.535 us, and half of the steps at most 16.383 us.
    assert found[f"{turnaround}_bucket", frozenset({west, ("le", "6.5535e-05")})] == 65.0
    step = "linemate_step_time_seconds_bucket"
    assert found[step, frozenset({west, ("le", "1.6383e-05")})] == 500.0
    summary = found["linemate_turnaround_seconds", frozenset({west, ("quantile", "1")})]
    assert summary == pytest.approx(0.001)
    assert found["linemate_period_seconds", frozenset({west})] == pytest.approx(0.01198)


def test_the_drift_of_the_dead_time_is_in_seconds() -> None:
    drifted = {"dead_time": {"drift_ms": 32.5, "least_ms": 0.0, "most_ms": 110.0}}
    found = parsed(metrics_page.text({"west": drifted}))
    name = "linemate_dead_time_drift_seconds"
    assert found[name, frozenset({("station", "west")})] == pytest.approx(0.0325)


def test_the_tool_prints_a_page_and_refuses_to_be_reached_by_others(daemon: DaemonProcess) -> None:
    where = f"west={daemon.listening['command']['socket']}"
    once = subprocess.run(
        [*LINEMATE, "metrics", "--once", "--station", where],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ("linemate_up", frozenset({("station", "west")})) in parsed(once.stdout)
    missing = [*LINEMATE, "metrics", "--once", "--station", "x=/missing"]
    assert subprocess.run(missing, capture_output=True, check=False).returncode == 3
    open_to_all = subprocess.run(
        [*LINEMATE, "metrics", "--listen", "0.0.0.0:0"], capture_output=True, text=True, check=False
    )
    assert open_to_all.returncode == 2
    assert open_to_all.stderr.count("\n") == 1
