"""Run jobs on a dask cluster.

Invariants:
    The result is the same as that of a local run.
    Workers with other sources than the caller's are refused before the first job.
    A job that fails raises here.
    dask is an extra and is imported on use.
"""

import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from linemate.simulators.harness.cell.variants import SetupError

SCHEMES = ("tcp", "tls", "ws", "wss")
CONNECT_S = 10.0
WORKERS_S = 60.0
PACKAGES = ("protocol", "drivers", "daemon", "simulators")
SUFFIXES = (".py", ".yaml", ".xml", ".urdf", ".dbc")

Job = TypeVar("Job")
Result = TypeVar("Result")

_ALONE = threading.Lock()
"""One job a process at a time: compiled parameters hold an arm that is no two threads' own."""


class ClusterError(SetupError):
    """The cluster cannot be used; the message says why and what to do."""


def is_address(text: str) -> bool:
    """Return whether a text is a scheduler's address, such as ``tcp://127.0.0.1:8786``."""
    scheme, separator, rest = text.partition("://")
    return scheme in SCHEMES and bool(separator) and bool(rest)


def execute(
    perform: Callable[[Job], Result],
    jobs: Sequence[Job],
    address: str,
    progress: Callable[[], None],
) -> list[Result]:
    """Run jobs on the cluster behind a scheduler.

    Args:
        jobs: what it is called with, one after another.
        progress: called after each job.

    Returns:
        Results in the order of the jobs.

    Raises:
        ClusterError: no dask here, no scheduler or no worker there, or other sources on one.
    """
    distributed = _distributed()
    with _client(distributed, address) as client:
        _require_same_sources(client, address)
        futures = client.map(_Alone(perform), jobs, pure=False, retries=0)
        for future in distributed.as_completed(futures, loop=client.loop):
            if future.status == "error":
                # The first failure ends it, as it does locally.
                failure: BaseException = future.exception()
                client.cancel(futures)
                raise failure
            progress()
        results: list[Result] = client.gather(futures)
    return results


class _Alone:
    """A function that runs once at a time in its process."""

    def __init__(self, perform: Callable[[Any], Any]) -> None:
        self._perform = perform

    def __call__(self, job: Any) -> Any:
        with _ALONE:
            return self._perform(job)


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        what = (
            "a scheduler's address needs dask, the extra 'cluster': pip install linemate[cluster]"
        )
        raise ClusterError(f"{what} ({error})") from None


@contextmanager
def _client(distributed: Any, address: str) -> Iterator[Any]:
    try:
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError as error:
        raise ClusterError(f"no scheduler answers at {address}: {error}") from error
    try:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise ClusterError(f"the scheduler at {address} has no workers") from None
        yield client
    finally:
        client.close()


def _require_same_sources(client: Any, address: str) -> None:
    own = digest()
    try:
        theirs: dict[str, str] = client.run(digest)
    except ImportError as error:
        raise ClusterError(f"a worker of {address} lacks linemate: {error}") from error
    other = sorted(worker for worker, theirs_digest in theirs.items() if theirs_digest != own)
    if other:
        names = ", ".join(other[:5])
        raise ClusterError(f"other sources of linemate than here on workers of {address}: {names}")


def digest() -> str:
    """A digest of all that a result depends on: every source and every shipped file."""
    whole = hashlib.blake2b(digest_size=16)
    for name, path in sorted(_sources()):
        whole.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return whole.hexdigest()


def _sources() -> Iterator[tuple[str, Path]]:
    """Name each file by its package and its place in it: the roots may differ."""
    for package in PACKAGES:
        spec = find_spec(f"linemate.{package}")
        for root in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in Path(root).rglob("*"):
                if path.is_file() and path.suffix in SUFFIXES:
                    yield f"{package}/{path.relative_to(root).as_posix()}", path
