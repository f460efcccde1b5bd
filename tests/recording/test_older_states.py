"""A state of an older version is not taken up where its shape is another one."""

import pytest
from msgspec import structs

from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.core.tracking.task import ConveyorClasses
from linemate.daemon.recording.step_replay import _same_shapes

BANK = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), 0.00038)


@pytest.mark.parametrize("name", ["changes", "impulses"])
def test_a_bank_with_fewer_sums_a_hypothesis_is_refused(name: str) -> None:
    state = BANK.initial(0.0)
    assert _same_shapes(state, BANK.advance(state, (), 0.012))
    bank = getattr(state, name)
    older = structs.replace(bank, sums=bank.sums[:-1])
    assert not _same_shapes(state, structs.replace(state, **{name: older}))
