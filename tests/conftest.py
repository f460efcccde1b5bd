"""What holds for every test: the shipped task, compiled once, and some steps."""

import os
import signal
import zlib
from collections.abc import Callable, Iterator

import pytest
from hypothesis import HealthCheck, settings

# Before numpy is imported, as the programs do: a second thread of BLAS made identification take 1.7
# times the processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core import step as stepping
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.cycle.step_log import LogEntry
from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)

# A shell ignores SIGINT for what it starts in the background, and children inherit that: the tests
# that interrupt a program would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

CYCLE_NS = 12_000_000


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--share", type=int, default=1, metavar="N", help="of rows, one in N; 1: all")
    parser.addoption("--share-of", default="", metavar="TEXT", help="another text, other rows")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out most of the tests that are marked as rows; which ones, the text says."""
    share, text = config.getoption("--share"), config.getoption("--share-of")
    kept, left_out = [], []
    for item in items:
        row = item.get_closest_marker("row")
        # Rows that share what takes long are left out together.
        name = row.args[0] if row is not None and row.args else item.name
        is_one = zlib.crc32(f"{text} {name}".encode()) % share == 0
        (kept if is_one or row is None else left_out).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = kept


@pytest.fixture
def within(record_property: Callable[[str, object], None]) -> Callable[[str, float, float], None]:
    """Give a check that a figure is at most so much; ``docs.make.catalogue`` reads what it was."""

    def check(what: str, measured: float, most: float) -> None:
        record_property(what, f"{measured:.6g} {most:.6g}")
        assert measured <= most, what

    return check


# How long an example takes says something of the machine's other work, not of the program.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


@pytest.fixture(autouse=True, scope="session")
def nice() -> Iterator[Callable[[int], int]]:
    """Keep the priority of programs that run in this process: all later tests would starve.

    What it yields is the true `os.nice`.
    """
    nice = os.nice
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "nice", lambda _: 0)
        yield nice


@pytest.fixture(scope="session")
def task() -> Task:
    return task_file.load(DAEMON_DATA / "wheel.yaml")


@pytest.fixture(scope="session")
def parameters(task: Task) -> Parameters:
    return compiling.build(task.file, task.urdf, TrackingSettings(), ControlSettings(), 0.012)


@pytest.fixture(scope="session")
def entries(task: Task, parameters: Parameters) -> tuple[LogEntry, ...]:
    """Twenty steps of a robot that begins to track a slowly moving object."""
    rest = task.file.arm.rest_joints
    state = stepping.initial(parameters, RobotSample(0, 0, rest, (0.0,) * 6))
    made: list[LogEntry] = []
    for k in range(20):
        stamp = 1_000_000_000 + k * CYCLE_NS
        inputs = Inputs(
            k=k,
            stamp_ns=stamp,
            robot=RobotSample(stamp - CYCLE_NS, 12 * k, rest, (0.1 / 3.0,) * 6, 0, 1),
            distance=(DistanceSample(stamp - 1_000_000, 0.00127 * k, 77.0),),
            camera=(
                CameraSample(
                    stamp - 2_000_000,
                    stamp - 100_000_000,
                    "cam",
                    "camera",
                    "hub",
                    k,
                    (0.1, 0.2, 0.7),
                    (1.0, 0.0, 0.0, 0.0),
                    tuple(1e-7 * (i + 1) for i in range(21)),
                ),
            )
            if k % 3 == 0
            else (),
            wrench=(WrenchSample(stamp, (0.1, -0.2, 0.3), (0.0, -0.0, 1e-9), 0, 5, 21.5),) * 3,
            order=MotionOrder.TRACK if k > 10 else MotionOrder.HOLD,
            start=k == 11,
        )
        state, outputs = stepping.step(state, inputs, parameters)
        made.append(LogEntry(12 * k if k != 7 else None, "track", inputs, outputs))
    return tuple(made)
