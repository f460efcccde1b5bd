"""Stations of a cycle: one that begins, and one whose robot moves."""

from copy import deepcopy

import pytest
from cycle_station import Station

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters


@pytest.fixture
def station(parameters: Parameters, task: Task) -> Station:
    return Station(parameters, task)


@pytest.fixture(scope="package")
def tracked(parameters: Parameters, task: Task) -> Station:
    """A station whose robot moves at the conveyor's speed; without its log it is copied quickly."""
    station = Station(parameters, task).track(163)
    station.cycle.take_log()
    return station


@pytest.fixture
def moving(tracked: Station) -> Station:
    return deepcopy(tracked, {id(tracked.parameters): tracked.parameters})
