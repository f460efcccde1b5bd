"""Cars before the judged one in the same cell: what their touches teach the daemon.

Invariants:
    The cell keeps its fixed errors: those of the scenario, and the arm's zeros and links, which
        the judged run's seed draws. Everything else is another car's.
    The daemon learns by its own learner, from nothing but its own steps.
"""

from dataclasses import replace

from linemate.daemon.config.settings_tree import Settings, change
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle.learning import position_sensors
from linemate.daemon.cycle.learning.distances import DistanceLearner
from linemate.daemon.cycle.learning.touches import TouchLearner
from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import lockstep
from linemate.simulators.harness.setup import Setup

FIRST_SEED = 500_000  # of the cars before a judged one: of no run of its own
MOST_CARS = 100


def taught(setup: Setup, seed: int, cars: int) -> Setup:
    """Return a setup with what some cars have taught the daemon.

    Args:
        seed: of the judged run, whose cell it is unless the scenario states its own.
    """
    touches, distances = TouchLearner(), DistanceLearner()

    def record(entry: LogEntry) -> None:
        touches.record_touch((entry,))
        distances.record_motion((entry,))

    own = setup.scenario.cell_seed
    cell_seed = seed if own is None else own
    cell = replace(setup, scenario=replace(setup.scenario, cell_seed=cell_seed))
    for car in range(cars):
        known = replace(cell, tracking=setup.tracking)
        lockstep.run(known, FIRST_SEED + MOST_CARS * seed + car, on_step=record)
        settings = Settings(setup.tracking, setup.control, WatchSettings())
        for _, _, values in position_sensors.learned(distances, touches, setup.tracking):
            settings = change(settings, values)
        setup = replace(setup, tracking=settings.tracking)
    return setup
