"""Cars before the judged one in the same cell: what their touches teach the daemon.

Invariants:
    The cell keeps its fixed errors: those of the scenario, and the arm's zeros and links, which
        the judged run's seed draws. Everything else is another car's.
    The daemon learns by its own learner, from nothing but its own steps.
"""

from dataclasses import replace

from linemate.daemon.cycle.learning.distances import LATE, SCALE, DistanceLearner
from linemate.daemon.cycle.learning.touches import FELT, FELT_DEPTH, FELT_TURN, TouchLearner
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
    learner, distances = TouchLearner(), DistanceLearner()

    def record(entry: LogEntry) -> None:
        learner.record_touch((entry,))
        distances.record_motion((entry,))

    own = setup.scenario.cell_seed
    cell_seed = seed if own is None else own
    cell = replace(setup, scenario=replace(setup.scenario, cell_seed=cell_seed))
    for car in range(cars):
        known = replace(cell, tracking=setup.tracking)
        lockstep.run(known, FIRST_SEED + MOST_CARS * seed + car, on_step=record)
        camera, distance = setup.tracking.camera, setup.tracking.distance
        values = distances.keep(distance)
        late, scale = values.get(LATE, distance.late), values.get(SCALE, distance.scale)
        distance = replace(distance, late=late, scale=scale)
        if distances.spoils_touch:
            learner.touch = None  # it was off by the distance, not by the camera
        touched = learner.keep(camera)
        x, y = touched.get(FELT, camera.felt)
        a, b = touched.get(FELT_TURN, camera.felt_turn)
        depth = touched.get(FELT_DEPTH, camera.felt_depth)
        camera = replace(camera, felt=(x, y), felt_turn=(a, b), felt_depth=depth)
        tracking = replace(setup.tracking, camera=camera, distance=distance)
        setup = replace(setup, tracking=tracking)
    return setup
