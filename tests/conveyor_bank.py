"""A bank classifier that decides nothing by itself, for tests of its filter and its evidence."""

from conveyor_truth import DEVIATION

from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings, RippleSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

NEVER = 1e9
# Without ripple the filter's own noise does not depend on what it believes of the speed.
FUSION = FusionSettings(ripple=1e-9, slip=0.0, slip_walk=0.0)
NO_RIPPLE = RippleSettings(deviation=0.0)
SETTINGS = BankSettings(perceived=NEVER, stop_confirmed=NEVER, start_confirmed=NEVER)
BANK = BankClassifier(ConveyorClasses(), FUSION, SETTINGS, DEVIATION, ripple=NO_RIPPLE)
CAMERA_DELAY = 0.1
TOUCH = 0.00005
