"""Cars before the judged one in the same cell: what their touches teach the daemon.

Invariants:
    The cell keeps its fixed errors: those of the scenario, and the arm's zeros and links, which
        the judged run's seed draws. Everything else is another car's.
    The daemon learns by its own learner, from nothing but its own steps.
"""

from dataclasses import replace

from linemate.daemon.cycle.learning.touches import FELT, FELT_TURN, TouchLearner
from linemate.simulators.harness import lockstep
from linemate.simulators.harness.setup import Setup

FIRST_SEED = 500_000  # of the cars before a judged one: of no run of its own
MOST_CARS = 100


def taught(setup: Setup, seed: int, cars: int) -> Setup:
    """Return a setup with what some cars have taught the daemon.

    Args:
        seed: of the judged run, whose cell it is unless the scenario states its own.
    """
    learner = TouchLearner()
    own = setup.scenario.cell_seed
    cell_seed = seed if own is None else own
    cell = replace(setup, scenario=replace(setup.scenario, cell_seed=cell_seed))
    for car in range(cars):
        known = replace(cell, tracking=setup.tracking)
        lockstep.run(
            known,
            FIRST_SEED + MOST_CARS * seed + car,
            on_step=lambda entry: learner.record_touch((entry,)),
        )
        camera = setup.tracking.camera
        values = learner.keep(camera)
        x, y = values.get(FELT, camera.felt)
        a, b = values.get(FELT_TURN, camera.felt_turn)
        camera = replace(camera, felt=(x, y), felt_turn=(a, b))
        setup = replace(setup, tracking=replace(setup.tracking, camera=camera))
    return setup
