"""Entry of the log of steps, for the recorder and others that look at them later."""

from msgspec import Struct

from linemate.daemon.core.inputs import Inputs
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.core.step_state import Outputs, StepState


class LogEntry(Struct, frozen=True):
    """One step, with what it was made from.

    Attributes:
        counter: the one it answered, None if it answered none.
        before, after: the step's own state; where ``before`` is not the ``after`` of the entry
            before, a session began, or steps are missing.
    """

    counter: int | None
    state: str
    inputs: Inputs
    outputs: Outputs
    before: StepState | None = None
    after: StepState | None = None
    parameters: Parameters | None = None
