"""Who is the camera: the rule, over all that senders do."""

import random

import pytest

from linemate.drivers.udp.camera_peer import TAKEOVER_S, CameraPeer, SenderRole
from linemate.protocol.numeric_peer import parse_peer

A, B, C = ("10.0.0.1", 5), ("10.0.0.1", 6), ("10.0.0.2", 5)
SECOND = 1_000_000_000
HEARD, CANDIDATE, FOREIGN = SenderRole.ACTIVE, SenderRole.CANDIDATE, SenderRole.FOREIGN


def learned(needed: int = 5) -> CameraPeer:
    """A rule whose camera is A since 1 s."""
    peer = CameraPeer(needed=needed)
    for _ in range(needed):
        assert peer.role(A, SECOND) is HEARD
        peer.note_pose(A, SECOND)
    assert peer.camera == peer.present == A
    return peer


@pytest.mark.parametrize("stranger", [B, C])
def test_no_other_sender_is_used_while_the_camera_sends(stranger: tuple[str, int]) -> None:
    peer = learned()
    before = SECOND + round(TAKEOVER_S * 1e9)
    assert peer.role(stranger, before - 1) is FOREIGN
    assert peer.role(stranger, before) is CANDIDATE


def test_five_good_poses_in_a_row_take_over_from_a_silent_camera() -> None:
    peer = learned()
    late = SECOND + round(TAKEOVER_S * 1e9)
    changes = [peer.note_pose(source, late) for source in (B, B, C, B, B, B, B)]
    assert not any(changes)
    assert peer.note_pose(B, late)
    assert (peer.present, peer.camera) == (B, A)
    assert peer.role(C, late) is FOREIGN


def test_the_camera_is_heard_at_once_when_it_is_back() -> None:
    peer = learned()
    late = SECOND + round(TAKEOVER_S * 1e9)
    for _ in range(5):
        peer.note_pose(B, late)
    assert peer.role(A, late) is HEARD
    assert peer.note_pose(A, late)
    assert peer.present == A
    assert peer.role(B, late + 1) is FOREIGN


def test_in_any_order_the_camera_is_used_and_no_other_sender_while_it_sends() -> None:
    for seed in range(200):
        draw = random.Random(seed)
        peer, at_ns, last_ns = learned(), SECOND, SECOND
        for _ in range(300):
            at_ns += draw.choice([1, SECOND // 30, SECOND, 6 * SECOND])
            source = draw.choice([A, B, C])
            judgement = peer.role(source, at_ns)
            if source == A:
                assert judgement is HEARD
                last_ns = at_ns
            elif at_ns - last_ns < TAKEOVER_S * 1e9:
                assert judgement is FOREIGN
            if judgement is not FOREIGN:
                peer.note_pose(source, at_ns)
            if source == A:
                assert peer.present == A


@pytest.mark.parametrize(
    ("text", "heard"),
    [("10.0.0.1", {A, B}), ("10.0.0.1:5", {A}), ("10.0.0.2:5", {C}), ("10.0.0.3", set())],
)
def test_with_a_peer_no_other_sender_is_ever_used(text: str, heard: set[tuple[str, int]]) -> None:
    found = {one for one in (A, B, C) if CameraPeer(parse_peer(text)).role(one, 0) is not FOREIGN}
    assert found == heard
