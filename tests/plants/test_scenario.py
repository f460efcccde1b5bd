"""Values of a scenario: defaults, and plain values all the way down."""

from dataclasses import replace

import pytest

from linemate.simulators.plants.conveyor_plan import Conveyor
from linemate.simulators.plants.scenario import Scenario, to_dict


def test_the_default_events_are_the_papers() -> None:
    stop, start = Scenario().events
    assert (stop.kind, stop.onset_s, stop.acceleration) == ("stop", 5.0, -0.104)
    assert stop.settled_s == pytest.approx(6.019, abs=1e-3)
    assert (start.kind, start.onset_s, start.speed) == ("start", 9.0, 0.0)
    assert start.settled_s == pytest.approx(17.154, abs=1e-3)


def test_a_scenario_is_plain_values_all_the_way_down() -> None:
    plain = to_dict(replace(Scenario(), conveyor=Conveyor(events=())))
    assert plain["conveyor"]["events"] == []
    assert plain["body"]["swings"][0]["frequency_hz"] == 0.62

    def check(value: object) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                assert isinstance(key, str)
                check(item)
        elif isinstance(value, list):
            for item in value:
                check(item)
        else:
            assert value is None or isinstance(value, (str, int, float, bool))

    check(plain)
