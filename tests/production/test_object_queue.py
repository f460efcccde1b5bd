"""The queue of announced parts: order, bounds and refusals."""

from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.production.object_queue import (
    MOST_KNOWN,
    MOST_WAITING,
    AnnouncedPart,
    ObjectQueue,
)


def part(number: int, distance: float | None = None) -> AnnouncedPart:
    return AnnouncedPart(f"P{number}", "sedan", float(number) if distance is None else distance)


def test_parts_come_in_the_order_of_the_conveyor() -> None:
    queue = ObjectQueue({"sedan"})
    assert [queue.announce(part(n)) for n in range(3)] == [None, None, None]
    assert [queue.pop_part().part for _ in range(3)] == ["P0", "P1", "P2"]
    assert queue.next is None


def test_an_unknown_variant_is_refused() -> None:
    queue = ObjectQueue({"sedan"})
    reason = queue.announce(AnnouncedPart("P1", "tractor", 0.0))
    assert reason == "variant 'tractor' is not known. Add it to production.variants."
    assert len(queue) == 0


def test_a_part_is_announced_once_even_if_it_has_gone() -> None:
    queue = ObjectQueue({"sedan"})
    queue.announce(part(1))
    queue.pop_part()
    assert queue.announce(part(1)) == "part 'P1' was announced before"


def test_a_part_behind_the_last_one_is_refused() -> None:
    queue = ObjectQueue({"sedan"})
    queue.announce(part(5))
    assert "Announce parts in their order" in str(queue.announce(part(4)))


def test_a_full_queue_refuses_and_says_so() -> None:
    queue = ObjectQueue({"sedan"})
    for number in range(MOST_WAITING):
        assert queue.announce(part(number)) is None
    assert (
        queue.announce(part(99)) == f"{MOST_WAITING} parts wait, at most {MOST_WAITING}. Skip some."
    )
    assert len(queue) == MOST_WAITING


def test_a_part_is_removed_by_its_name() -> None:
    queue = ObjectQueue({"sedan"})
    for number in range(3):
        queue.announce(part(number))
    removed = queue.remove("P1")
    assert removed is not None
    assert removed.part == "P1"
    assert queue.remove("P1") is None
    assert [each.part for each in queue.waiting] == ["P0", "P2"]


@given(st.lists(st.tuples(st.integers(0, 400), st.booleans()), max_size=600))
def test_the_queue_stays_bounded_and_sorted_whatever_comes(orders: list[tuple[int, bool]]) -> None:
    queue = ObjectQueue({"sedan"})
    for number, takes in orders:
        if takes and len(queue):
            queue.pop_part()
        else:
            queue.announce(part(number))
        distances = [each.distance for each in queue.waiting]
        assert distances == sorted(distances)
        assert len(queue) <= MOST_WAITING
    assert len(queue._known) <= MOST_KNOWN
