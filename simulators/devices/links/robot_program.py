"""A robot's program as the emulated controllers of each family show it on the wire."""

from linemate.simulators.devices.egm.egm_controller import EgmController
from linemate.simulators.devices.fanuc.fanuc_controller import FanucController
from linemate.simulators.devices.rsi_controller import RsiController
from linemate.simulators.plants.scenario import Vector7

Controller = RsiController | FanucController | EgmController


def standing(controller: Controller) -> Vector7:
    """Return where the robot is sent, A1..A6 [rad], E1 [m]."""
    return controller.standing if isinstance(controller, EgmController) else controller.setpoints


def show(controller: Controller, *, is_running: bool, has_drives: bool) -> None:
    """Let a controller's telegrams say whether its program runs and its drives are on.

    RSI's say neither. EGM sends none while RAPID is between two runs.
    """
    if isinstance(controller, FanucController):
        controller.is_program_running = is_running
        controller.is_emergency_stop = not has_drives
    elif isinstance(controller, EgmController):
        controller.is_motors_on = has_drives


def paused_telegram(controller: Controller) -> bytes | None:
    """Return a controller's telegram while its program does not run, None if it sends none."""
    return controller.telegram() if isinstance(controller, FanucController) else None


def answers(controller: Controller) -> list[bytes]:
    """Return the answers to requests of the daemon, oldest first."""
    return controller.take_answers() if isinstance(controller, FanucController) else []
