"""A whole run of the step, made once for its tests."""

import pytest
from step_runs import Assembly, whole_assembly


@pytest.fixture(scope="session")
def assembly() -> Assembly:
    """The whole task next to a conveyor that never stops: the tool does what it is asked for."""
    return whole_assembly()
