"""Random streams by seed and name."""

from linemate.simulators.plants.streams import Draws, stream


def test_draws_are_the_same_singly_and_in_groups() -> None:
    singly, grouped = Draws.normal(3, "x"), Draws.normal(3, "x")
    values = [singly.next_number() for _ in range(1200)]
    taken: list[float] = []
    while len(taken) < 1200:
        taken += grouped.next_numbers(7) if len(taken) % 2 else [grouped.next_number()]
    assert taken[:1200] == values
    assert values[:600] == stream(3, "x").standard_normal(600).tolist()


def test_streams_differ_by_name_and_by_seed() -> None:
    first = stream(1, "a").random(4).tolist()
    assert first == stream(1, "a").random(4).tolist()
    assert first != stream(1, "b").random(4).tolist()
    assert first != stream(2, "a").random(4).tolist()
