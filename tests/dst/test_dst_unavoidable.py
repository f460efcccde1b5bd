"""The rule of what a plan makes unavoidable: every limit of it, from both sides."""

from dataclasses import replace

import pytest

from linemate.simulators.lab.faults.dst_unavoidable import Loss, excuse

INF = float("inf")
COMMANDS = Loss("commands", 1.0, 1.13, at_hub=True, travel_m=0.014, speed_change=0.0)
POSITION = Loss("position", 1.0, 1.6, at_hub=True, travel_m=0.05, speed_change=0.05)
PROGRAMME = Loss("programme", 1.0, INF, at_hub=True, travel_m=0.02, speed_change=0.0)


def test_without_a_loss_nothing_is_unavoidable() -> None:
    assert excuse("collision", 1.0, ()) is None


@pytest.mark.parametrize("loss", [COMMANDS, POSITION, PROGRAMME])
def test_a_loss_that_was_long_enough_and_at_the_hub_excuses_a_collision(loss: Loss) -> None:
    assert excuse("collision", 1.59, [replace(loss, end_s=1.6)]) is not None


@pytest.mark.parametrize("loss", [COMMANDS, POSITION, PROGRAMME])
@pytest.mark.parametrize("changes", [{"at_hub": False}, {"begin_s": 1.6, "end_s": 2.5}])
def test_a_loss_elsewhere_or_later_excuses_nothing(loss: Loss, changes: dict[str, float]) -> None:
    assert excuse("collision", 1.59, [replace(replace(loss, end_s=1.6), **changes)]) is None


@pytest.mark.parametrize(
    ("loss", "changes"),
    [
        (COMMANDS, {"travel_m": 0.007}),
        (PROGRAMME, {"travel_m": 0.007}),
        (PROGRAMME, {"was_moved": True}),
        (POSITION, {"speed_change": 0.009}),
        (POSITION, {"end_s": 1.49}),
    ],
)
def test_a_hub_that_stood_a_line_that_went_on_and_a_robot_that_was_moved_are_no_excuse(
    loss: Loss, changes: dict[str, float]
) -> None:
    at_s = min(loss.end_s, 1.5)
    assert excuse("collision", at_s, [loss]) is not None or loss is POSITION
    assert excuse("collision", at_s, [replace(loss, **changes)]) is None


@pytest.mark.parametrize(
    ("lasted_s", "force", "collision"),
    [(0.02, False, False), (0.079, False, False), (0.09, True, False), (0.13, True, True)],
)
def test_a_short_loss_of_commands_excuses_a_force_before_it_excuses_a_collision(
    lasted_s: float, force: bool, collision: bool
) -> None:
    loss = replace(COMMANDS, end_s=1.0 + lasted_s)
    at_s = loss.end_s + 0.05
    assert (excuse("force", at_s, [loss]) is not None) is force
    assert (excuse("collision", at_s, [loss]) is not None) is collision


@pytest.mark.parametrize(("loss", "recovery_s"), [(COMMANDS, 0.15), (POSITION, 0.5)])
def test_a_loss_excuses_nothing_any_more_some_time_after_its_end(
    loss: Loss, recovery_s: float
) -> None:
    assert excuse("collision", loss.end_s + recovery_s - 0.001, [loss]) is loss
    assert excuse("collision", loss.end_s + recovery_s + 0.001, [loss]) is None


def test_a_programme_that_is_not_back_excuses_for_as_long_as_the_tool_is_held() -> None:
    assert excuse("collision", 30.0, [PROGRAMME]) is PROGRAMME
    assert excuse("collision", 2.01, [replace(PROGRAMME, end_s=2.0)]) is None


@pytest.mark.parametrize("loss", [COMMANDS, PROGRAMME])
@pytest.mark.parametrize(
    ("travel_m", "force", "collision"),
    [(0.0039, False, False), (0.0041, True, False), (0.0081, True, True)],
)
def test_a_hub_that_moved_4_mm_excuses_a_force_and_one_that_moved_8_mm_a_collision(
    loss: Loss, travel_m: float, force: bool, collision: bool
) -> None:
    losses = [replace(loss, travel_m=travel_m)]
    assert (excuse("force", 1.2, losses) is not None) is force
    assert (excuse("collision", 1.2, losses) is not None) is collision
