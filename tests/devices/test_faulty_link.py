"""What a faulty link does to bytes: exactly what is asked for, reproducibly."""

import pytest

from linemate.simulators.devices.faults import Faults
from linemate.simulators.devices.faulty_link import FaultyLink
from linemate.simulators.plants.scenario import Fault

TELEGRAM = b'<Rob Type="KUKA"><AIPos A1="1.0"/><Delay D="12"/><IPOC>4208163634</IPOC></Rob>'


def link(kind: str, value: float = 0.0, count: int = 1, name: str = "camera") -> FaultyLink:
    faults = Faults([Fault(1.0, name, kind, duration_s=1.0, value=value, count=count)])
    return FaultyLink(name, faults, seed=7, ordered=name == "distance")


def sent(way: FaultyLink, count: int = 200, data: bytes = b"0123456789") -> list[list[bytes]]:
    return [[piece for _, piece in way.carry(data, 1.0 + 0.004 * i)] for i in range(count)]


def test_a_link_without_faults_carries_everything_at_once() -> None:
    way = FaultyLink("camera", Faults(), seed=1)
    assert way.carry(b"abc", 1.5) == [(1.5, b"abc")]


def test_before_and_after_its_fault_a_link_is_sound() -> None:
    way = link("silence")
    assert way.carry(b"abc", 0.999) == [(0.999, b"abc")]
    assert way.carry(b"abc", 1.0) == []
    assert way.carry(b"abc", 2.0) == [(2.0, b"abc")]
    assert way.suffered["silence"] == 1


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_loss_takes_its_share(share: float) -> None:
    way = link("loss", share)
    lost = sum(not pieces for pieces in sent(way))
    assert lost == way.suffered["loss"]
    assert abs(lost / 200 - share) < 0.1


def test_delay_shifts_by_its_value_and_jitter_by_a_bounded_time() -> None:
    assert link("delay", 0.05).carry(b"a", 1.0) == [(1.05, b"a")]
    way = link("jitter", 0.01)
    late = [way.carry(b"a", 1.0 + 0.001 * i)[0][0] - (1.0 + 0.001 * i) for i in range(500)]
    assert min(late) >= 0.0
    assert max(late) <= 0.08 + 1e-12
    assert 0.007 < sum(late) / 500 < 0.013


def test_on_a_bus_nothing_overtakes_anything() -> None:
    way = link("jitter", 0.02, name="distance")
    times = [at for i in range(200) for at, _ in way.carry(b"a", 1.0 + 0.004 * i)]
    assert times == sorted(times)


def test_a_duplicate_comes_after_the_first_and_is_its_equal() -> None:
    (first, data), (second, again) = link("duplicate", 1.0).carry(b"abc", 1.0)
    assert (first, data, again) == (1.0, b"abc", b"abc")
    assert second > first


def test_a_piece_that_is_overtaken_comes_right_behind_the_next_one() -> None:
    way = link("reorder", 1.0)
    assert way.carry(b"a", 1.0) == []
    pieces = way.carry(b"b", 1.1)
    assert [data for _, data in pieces] == [b"b", b"a"]
    assert 1.1 == pieces[0][0] < pieces[1][0]


def test_reordering_loses_nothing_once_the_fault_is_over() -> None:
    way = link("reorder", 0.5)
    found = [data for i in range(250) for _, data in way.carry(b"%d" % i, 1.0 + 0.004 * i)]
    found += [data for _, data in way.carry(b"last", 2.5)]
    assert way.suffered["reorder"] > 20
    assert sorted(found) == sorted([*(b"%d" % i for i in range(250)), b"last"])


def test_as_many_bits_are_flipped_as_asked_for() -> None:
    for (spoilt,) in sent(link("flip", 1.0, count=1)):
        flips = sum((a ^ b).bit_count() for a, b in zip(spoilt, b"0123456789", strict=True))
        assert flips == 1


def test_a_flip_spares_the_delay_which_nothing_else_could_vouch_for() -> None:
    for (spoilt,) in sent(link("flip", 1.0, count=8, name="robot"), data=TELEGRAM):
        assert b'<Delay D="12"/>' in spoilt
        assert spoilt != TELEGRAM


def test_a_flip_in_the_counter_changes_one_bit_of_it_and_nothing_else() -> None:
    for (spoilt,) in sent(link("ipoc_flip", 1.0, name="robot"), data=TELEGRAM):
        head, _, rest = spoilt.partition(b"<IPOC>")
        digits, _, tail = rest.partition(b"<")
        assert (int(digits) ^ 4208163634).bit_count() == 1
        assert TELEGRAM.startswith(head + b"<IPOC>")
        assert TELEGRAM.endswith(tail)


def test_a_truncated_piece_is_a_beginning_of_it() -> None:
    for (cut,) in sent(link("truncate", 1.0)):
        assert b"0123456789".startswith(cut)
        assert len(cut) < 10


def test_one_seed_gives_one_history_and_another_fault_does_not_shift_it() -> None:
    loss = Fault(1.0, "camera", "loss", 1.0, 0.5)
    other = Fault(1.2, "camera", "flip", 0.5, 0.5)

    def history(*faults: Fault, seed: int = 3) -> list[bool]:
        return [bool(pieces) for pieces in sent(FaultyLink("camera", Faults(faults), seed))]

    assert history(loss) == history(loss)
    assert history(loss) == history(loss, other)
    assert history(loss) != history(loss, seed=4)


def test_an_unreadable_telegram_keeps_its_counter_and_has_one_value_that_is_no_number() -> None:
    telegram = b'<Rob><AIPos A1="1.50000000" A2="-2.25000000"/><IPOC>1234</IPOC></Rob>'
    fault = Fault(0.0, "robot", "unreadable", 1.0, 1.0)
    (piece,) = FaultyLink("robot", Faults([fault]), 3).carry(telegram, 0.5)
    assert b"<IPOC>1234</IPOC>" in piece[1]
    assert (b"1.50000000" in piece[1]) != (b"-2.25000000" in piece[1])


def test_a_telegram_with_exponents_says_the_same() -> None:
    telegram = b'<Rob><AIPos A1="1.50000000" A2="-0.00000171"/><IPOC>1234</IPOC></Rob>'
    fault = Fault(0.0, "robot", "exponent", 1.0, 1.0)
    (piece,) = FaultyLink("robot", Faults([fault]), 3).carry(telegram, 0.5)
    assert b'A1="1.500000000000e+00" A2="-1.710000000000e-06"' in piece[1]
    assert b"<IPOC>1234</IPOC>" in piece[1]
