"""Robot controllers of a fault run by family: how each is made, stopped and disturbed.

Invariants:
    RSI's controller is made as ever. A rule of another family never applies to it.
    A rule reads the plan and the controller, never the daemon.
"""

from collections import Counter
from collections.abc import Callable

from linemate.protocol.fanuc.packets import PacketKind, write_short
from linemate.simulators.devices.fanuc.fanuc_controller import FanucController
from linemate.simulators.devices.links.robot_program import Controller
from linemate.simulators.devices.rsi_controller import Applied, RobotReading, RsiController
from linemate.simulators.harness import cell_links
from linemate.simulators.lab.faults.dst_cells import axis_limits, rest_pose, station
from linemate.simulators.lab.faults.dst_plan import FaultPlan, end_of
from linemate.simulators.plants.scenario import Vector7

UNCERTAIN = {
    "robot": frozenset({"deafness", "delay", "jitter", "reorder", "flip"}),
    "reply": frozenset({"silence", "loss", "delay", "jitter", "duplicate", "reorder", "truncate"}),
}
"""Faults after which the daemon cannot know which setpoint is in force, for no packet of these
families says what became of a reply: replies lost, late or doubled on the network, and a bit
flipped in a position that a plan begins from. docs/egm.md, docs/fanuc.md."""
UNCERTAIN_S = 0.1
"""So long after such a fault it still acts [s]."""
EXPECTED = frozenset({"not_ready", "no_stream", "unclean_stop", "sequence"})
"""Refusals that cost nothing: a command in flight as motion or stream ended, and EGM's
reply to an older message."""


def build(
    plan: FaultPlan, read: Callable[[], RobotReading], pose: Vector7, *, first: int | None = None
) -> Controller:
    """Return the controller of a plan's cell before its first cycle.

    Args:
        pose: where its robot stands, A1..A6 [rad], E1 [m].
        first: its first counter, None for its family's own.
    """
    # The controller counts in the cycle that it says it has.
    return cell_links.controller(
        station(plan.cell),
        read,
        pose,
        plan.cycle_s,
        axis_limits(plan.cell),
        timeout_rule="row" if plan.rule == "row" else "total",
        first=first,
    )


class StrictFamily:
    """Judges what FANUC and EGM controllers refuse. RSI counts it in ``Delay``.

    A setpoint beyond a limit is refused here, and never reaches the judge of setpoints.
    """

    def __init__(
        self, controller: Controller, plan: FaultPlan, blame: Callable[[str], None]
    ) -> None:
        """Begin before the first cycle."""
        self._controller, self._blame = controller, blame
        self._is_judged = not isinstance(controller, RsiController)
        self._seen: Counter[str] = Counter()
        self._uncertain = [
            (fault.at_s, end_of(fault) + UNCERTAIN_S)
            for fault in plan.faults
            if fault.kind in UNCERTAIN.get(fault.link, ())
        ]

    def is_uncertain(self, now_s: float) -> bool:
        """Return whether the daemon cannot know which setpoint is in force."""
        return any(begin_s <= now_s <= end_s for begin_s, end_s in self._uncertain)

    def judge_reply(self, now_s: float) -> None:
        """Report what was refused since the last call, and is the daemon's own doing."""
        if not self._is_judged or self._seen == self._controller.refusals:
            return
        for reason in self._controller.refusals - self._seen:
            if reason not in EXPECTED and not self.is_uncertain(now_s):
                text = self._controller.messages[-1] if self._controller.messages else ""
                self._blame(f"refused: {reason}: {text}")
        self._seen = self._controller.refusals.copy()

    def end_of_cycle(self, now_s: float) -> Applied:
        """Close a cycle. Only place and speed of a setpoint two steps ahead are judged."""
        if self._is_judged and self.is_uncertain(now_s):
            self._controller.judge.slip()
        return self._controller.end_of_cycle()


def second(plan: FaultPlan, first: int) -> Controller:
    """Return another controller of the same family, whose robot stands at the rest pose."""
    pose = rest_pose(plan.cell)
    controller = build(plan, lambda: RobotReading(pose, (0.0,) * 6), pose, first=first)
    if isinstance(controller, FanucController):
        controller.on_reply(write_short(PacketKind.START, controller.config.version))
        controller.jump(first)
    return controller
