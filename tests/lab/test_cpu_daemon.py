"""The account of processor time: exclusive, by part, of cycles in which the robot moves."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from linemate.daemon.cycle.states import State
from linemate.simulators.lab.bench import cpu_daemon
from linemate.simulators.lab.bench.cpu_daemon import REST, THREADS, Account, wrapped


class Clock:
    """Processor time that passes when a function says so [ns]."""

    def __init__(self) -> None:
        self.main = self.process = 0

    def spend(self, ns: int, others: int = 0) -> None:
        self.main += ns
        self.process += ns + others


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def account(clock: Clock) -> Account:
    return Account(clock=lambda: clock.main, process=lambda: clock.process)


def test_a_part_is_charged_without_what_it_calls_of_another(clock: Clock, account: Account) -> None:
    inner = wrapped(account, "inner", lambda: clock.spend(7_000))

    def work() -> None:
        clock.spend(2_000)
        inner()
        clock.spend(1_000)

    outer = wrapped(account, "outer", work)
    account.close_cycle(counts=True)
    clock.spend(500)
    outer()
    clock.spend(0, others=4_000)
    account.close_cycle(counts=True)
    found = cpu_daemon.figures(account, 100.0)
    assert found["parts_us"] == {"inner": 7.0, "outer": 3.0, REST: 0.5, THREADS: 4.0}
    assert (found["cycles"], found["all_us"]) == (1, 14.5)
    assert found["measurement_us"] == pytest.approx(0.2)


def test_a_part_that_fails_is_charged_and_its_caller_goes_on(
    clock: Clock, account: Account
) -> None:
    def fail() -> None:
        clock.spend(3_000)
        raise ValueError

    account.close_cycle(counts=True)
    with pytest.raises(ValueError):  # noqa: PT011 - its own
        wrapped(account, "a", fail)()
    clock.spend(1_000)
    wrapped(account, "b", lambda: clock.spend(2_000))()
    account.close_cycle(counts=True)
    assert cpu_daemon.figures(account, 0.0)["parts_us"] == {
        "a": 3.0, "b": 2.0, REST: 1.0, THREADS: 0.0,
    }  # fmt: skip


@pytest.mark.parametrize(("state", "cycles"), [(State.TRACK, 1), (State.IDLE, 0)])
def test_only_cycles_in_which_the_robot_moves_count(
    account: Account, state: State, cycles: int
) -> None:
    app = SimpleNamespace(cycle=SimpleNamespace(machine=SimpleNamespace(state=state)))
    after = cpu_daemon.closing(account, lambda _: None)
    after(app)
    after(app)
    assert account.cycles == cycles


def test_each_function_of_a_part_is_there() -> None:
    for _, module, name in cpu_daemon.PARTS:
        below = "linemate" if module.startswith("/") else "linemate.daemon"
        holder: Any = import_module(f"{below}.{module.lstrip('/')}")
        for each in name.split("."):
            holder = getattr(holder, each)
        assert callable(holder)


def test_a_wrapped_call_costs_a_few_microseconds() -> None:
    assert 0.0 < cpu_daemon.cost_of_a_call(200) < 1e6
