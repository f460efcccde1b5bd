"""``linemate.follow``: hand target poses in to a running daemon, in time and in small chunks.

Invariants:
- A chunk that is refused ends the handing in: the robot stops behind the last pose that it has.
- Poses are handed in at most ``lead_s`` ahead, so that a stop of this program stops the robot.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, Self

from linemate.daemon.transport.client import Client

LONGEST_CHUNK: Final = 12  # poses that one command takes
LEAD_S: Final = 1.0
BEGIN_S: Final = 0.5  # from the first call to the first pose [s]

TargetPose = tuple[float, Sequence[float]]
"""Time from the begin [s]; position in base [m] and unit quaternion, w first."""


class Follower:
    """Target poses for a running daemon.

    >>> with linemate.Follower() as follower:          # doctest: +SKIP
    ...     follower.hand_in([(0.0, pose_a), (0.1, pose_b)])

    The robot must stand idle, its tcp within 5 mm and 20 mrad of the first pose. Time 0 is
    ``begin_s`` after the Follower is made. Behind the last pose the robot stops and holds.

    Args:
        client: of the daemon; the one on this host without it. It needs the role ``operate``.
        begin_s: from now to time 0 [s].

    Raises:
        NoAnswerError: there is no daemon, or no answer in time.
        RefusedError: the daemon refused it.
    """

    def __init__(self, client: Client | None = None, begin_s: float = BEGIN_S) -> None:
        self._client = client or Client.local()
        self._owns_client = client is None
        asked = time.monotonic_ns()
        now_ns: int = self._client.call("follow", {"begin_ns": 0, "poses": []})["now_ns"]
        # The daemon read its clock between the request and the answer.
        self._offset_ns = now_ns - (asked + time.monotonic_ns()) // 2
        self._begin_ns = now_ns + round(1e9 * begin_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._owns_client:
            self._client.close()

    @property
    def time_s(self) -> float:
        """Time since the begin, on the daemon's clock [s]."""
        return (time.monotonic_ns() + self._offset_ns - self._begin_ns) * 1e-9

    def hand_in(self, poses: Sequence[TargetPose]) -> dict[str, Any]:
        """Hand poses in and return the daemon's last answer.

        They replace the poses from their first time on. Late poses are followed from where the
        robot is, without a jump.

        Args:
            poses: (time from the begin [s], (x, y, z, qw, qx, qy, qz)) with rising times.

        Raises:
            NoAnswerError: no answer in time.
            RefusedError: the daemon refused them; the robot keeps what it has.
            CommandError: a pose is not 8 finite numbers.
        """
        answer: dict[str, Any] = {}
        for first in range(0, len(poses), LONGEST_CHUNK):
            chunk = poses[first : first + LONGEST_CHUNK]
            # Times in a request count from its first pose, so that a long way has small ones.
            begin_s = float(chunk[0][0])
            rows = [[float(t) - begin_s, *map(float, pose)] for t, pose in chunk]
            begin_ns = self._begin_ns + round(1e9 * begin_s)
            answer = self._client.call("follow", {"begin_ns": begin_ns, "poses": rows})
        return answer


def follow(
    poses: Iterable[TargetPose],
    client: Client | None = None,
    *,
    lead_s: float = LEAD_S,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Let the robot follow target poses; return when the last ones are handed in.

    Args:
        poses: (time from the begin [s], (x, y, z, qw, qx, qy, qz)) in base, with rising times;
            may be a generator that computes them as it goes.
        client: connection to the daemon; one on this host without it.
        lead_s: how long before its time a pose is handed in at most [s]; with less than the
            delay of the link the robot stops and goes on.
        sleep: waits for some seconds.

    Raises:
        NoAnswerError: there is no daemon, or no answer in time.
        RefusedError: the daemon refused the poses.
        CommandError: a pose is not 8 finite numbers.
    """
    with Follower(client, begin_s=min(BEGIN_S, lead_s)) as follower:
        for chunk in _chunks(poses):
            # The robot needs the poses as far as the next chunk before it has passed this one.
            wait_s = float(chunk[0][0]) - lead_s - follower.time_s
            if wait_s > 0.0:
                sleep(wait_s)
            follower.hand_in(chunk)


def _chunks(poses: Iterable[TargetPose]) -> Iterator[list[TargetPose]]:
    chunk: list[TargetPose] = []
    for pose in poses:
        chunk.append(pose)
        if len(chunk) == LONGEST_CHUNK:
            yield chunk
            chunk = []
    if len(chunk) > 1 or (chunk and float(chunk[0][0]) > 0.0):
        yield chunk
