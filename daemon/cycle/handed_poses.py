"""Queue of target poses that clients hand in, until the next step takes them.

Invariants:
- A chunk that is queued fits the curve that the robot follows, with the chunks before it.
- At most MOST_CHUNKS wait, and a step takes at most STEP_CHUNKS of them: each costs a spline.
"""

from collections import deque

from msgspec.structs import replace

from linemate.daemon.core import step as stepping
from linemate.daemon.core.followed_poses import Chunk, ChunkError, FollowedPoses
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import StepState

MOST_CHUNKS = 8  # that wait
STEP_CHUNKS = 1  # that one step takes; a chunk costs about 1 ms


class HandedPoses:
    """Chunks that wait for the next step."""

    def __init__(self) -> None:
        self._chunks: deque[Chunk] = deque()
        self._ahead: FollowedPoses | None = None  # with all chunks that wait

    def add(
        self, state: StepState, chunk: Chunk, stamp_ns: int, parameters: Parameters
    ) -> str | None:
        """Queue a chunk; return why it is refused, None if it is not.

        Args:
            stamp_ns: of the last step [ns].
        """
        if len(self._chunks) >= MOST_CHUNKS:
            return f"{len(self._chunks)} chunks wait, limit {MOST_CHUNKS}. Hand in one a cycle."
        follow = stepping.followed(state)
        if self._chunks and self._ahead is not None:
            follow = replace(self._ahead, steps=follow.steps)
        try:
            self._ahead = stepping.extended(follow, chunk, stamp_ns, parameters)
        except ChunkError as error:
            return str(error)
        self._chunks.append(chunk)
        return None

    def drain(self, *, follows: bool) -> tuple[Chunk, ...]:
        """Return the next chunks; none if the robot does not follow: they are too late then."""
        if not self._chunks:
            return ()
        if not follows:
            self._chunks.clear()
            return ()
        count = min(STEP_CHUNKS, len(self._chunks))
        return tuple(self._chunks.popleft() for _ in range(count))
