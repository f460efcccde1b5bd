"""A sensor's queue loses no sample without counting it."""

from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.cycle.sensing.samples import SampleQueue, SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import Conditions, Health
from linemate.protocol.stamped_samples import DistanceSample, WrenchSample

CONDITIONS = Conditions(moving=False, deviation=0.0)


class Accepting(Health[DistanceSample]):
    """Accepts every sample at a positive place."""

    def accepts(self, sample: DistanceSample, conditions: Conditions) -> bool:
        return self.judge(sample.stamp_ns, None) and sample.position >= 0.0


@settings(max_examples=50)
@given(st.integers(1, 20), st.lists(st.one_of(st.none(), st.integers()), max_size=80))
def test_each_pushed_sample_is_drained_waits_or_is_counted(
    size: int, story: list[int | None]
) -> None:
    """``None`` drains, a number is pushed."""
    queue: SampleQueue[DistanceSample] = SampleQueue(size, Accepting())
    pushed: list[int] = []
    drained: list[int] = []
    for stamp_ns in story:
        if stamp_ns is None:
            drained += [sample.stamp_ns for sample in queue.drain(CONDITIONS)]
        else:
            queue.push(DistanceSample(stamp_ns, 1.0))
            pushed.append(stamp_ns)
    waiting = [sample.stamp_ns for sample in queue.drain(CONDITIONS)]
    assert len(waiting) <= size
    assert len(drained) + len(waiting) + queue.dropped == len(pushed)
    assert waiting == pushed[len(pushed) - len(waiting) :]


def test_the_newest_stamp_is_that_of_the_newest_accepted_sample() -> None:
    queue: SampleQueue[DistanceSample] = SampleQueue(4, Accepting())
    assert queue.fact.stamp_ns is None
    queue.push(DistanceSample(5, 1.0))
    queue.push(DistanceSample(7, -1.0))
    assert queue.fact.stamp_ns is None
    assert [sample.stamp_ns for sample in queue.drain(CONDITIONS)] == [5]
    assert queue.fact.stamp_ns == 5
    assert queue.drain(CONDITIONS) == ()
    assert queue.fact.stamp_ns == 5


def _is_overloaded(forces: list[float], *weights: float) -> bool:
    """Whether forces along z are an overload beyond 350 N, with possible weights along z."""
    queues = SensorQueues()
    for k, force in enumerate(forces):
        queues.wrench.push(WrenchSample(4_000_000 * k, (0.0, 0.1 * k, force), (0.0, 0.0, 0.0)))
    queues.drain(CONDITIONS, 350.0, tuple((0.0, 0.0, weight) for weight in weights))
    return queues.overloaded


def test_a_weight_that_the_mount_carries_is_no_overload() -> None:
    assert _is_overloaded([380.0, 385.0], 0.0)
    assert not _is_overloaded([380.0, 385.0], 294.0)


def test_a_force_beyond_the_weight_is_an_overload_whichever_way_it_pushes() -> None:
    assert _is_overloaded([660.0, 661.0], 294.0)
    assert _is_overloaded([-100.0, -101.0], 294.0)


def test_a_force_is_no_overload_if_one_of_the_possible_weights_explains_it() -> None:
    assert not _is_overloaded([380.0, 385.0], 0.0, 294.0)
    assert not _is_overloaded([-100.0, -101.0], 0.0, 294.0)
    assert _is_overloaded([660.0, 661.0], 0.0, 294.0)
