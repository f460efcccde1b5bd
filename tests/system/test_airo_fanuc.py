"""The daemon against a FANUC controller that somebody else wrote: airo-fanuc's FakeCRXController.

A violation of the protocol is never tolerated. In real time a packet without a command is only if
the host kept a process waiting, so a few are allowed. ``airo_peer.py`` exchanges 3000 cycles.
"""

import pytest

pytest.importorskip("airo_fanuc", reason="the test-only package airo-fanuc is not installed")

from tests.system.airo_peer import idle, in_motion

LOST_SHARE = 0.02  # of all cycles: what a shared host loses


@pytest.mark.parametrize("version", [3, 4])
def test_every_packet_is_answered_in_motion_and_no_command_is_a_violation(version: int) -> None:
    outcome = in_motion(900, version)
    assert outcome["cycles"] == 900
    assert outcome["unanswered"] == 0
    assert outcome["refused"] == 0
    assert outcome["state"] == "track"
    assert outcome["farthest_deg"] > 10.0
    assert outcome["farthest_mm"] > 100.0


def test_the_daemons_process_answers_in_real_time_and_ends_the_stream_cleanly() -> None:
    outcome = idle(250, 3)
    assert outcome["unanswered"] <= LOST_SHARE * 250
    assert outcome["violations"] == []
    assert outcome["counters"]["unanswered"] == outcome["unreadable"] == outcome["faults"] == 0
    assert outcome["state"] in {"idle", "init"}
    assert outcome["exit"] == 0
