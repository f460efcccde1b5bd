"""A daemon's parameter service, with a cycle that a robot at rest keeps going."""

from pathlib import Path
from typing import Any

from linemate.daemon.config import config
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.service.parameter_service import ParameterService
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.stamped_samples import DistanceSample

CYCLE_NS = 12_000_000
TEXT = "task: wheel.yaml\nstate: .\ncontrol: {brake: {jerk: 20.0}}\n"


class Standing:
    """A daemon's service with a cycle that a robot at rest keeps going."""

    def __init__(self, folder: Path, parameters: Parameters, task: Task) -> None:
        self.path = folder / "linemated.yaml"
        if not self.path.exists():
            self.path.write_text(TEXT)
        self.station = config.load(self.path)
        assert self.station.controller_file is not None
        self._codec = RsiCodec(self.station.controller_file)
        self.cycle = Cycle(parameters, RsiLink(self._codec, on_rail=True))
        self.cycle.listen(0)
        self.changes: list[tuple[Parameters, str, Any]] = []
        self.lines: list[str] = []
        self.service = ParameterService(
            self.station, self.cycle, lambda *what: self.changes.append(what), self.lines.append
        )
        self._rest = task.file.arm.rest_joints
        self._k = 0

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self._k += 1
            stamp = 10**12 + self._k * CYCLE_NS
            self.cycle.samples.distance.push(DistanceSample(stamp - 10**6, 0.00127 * self._k))
            telegram = RobotTelegram(
                4_000_000 + 12 * self._k,
                joints=self._rest,
                external=(0.0,) * 6,
                tcp=(0.0,) * 6,
                delay=0,
                channels={"DiL": 0},
            )
            assert self.cycle.on_telegram(self._codec.format_robot(telegram), stamp)

    def set(self, **values: Any) -> dict[str, Any]:
        """Set, and wait for the promise if there is one."""
        named = {name.replace("__", "."): value for name, value in values.items()}
        return self.assign(named)

    def assign(self, values: dict[str, Any], who: str = "uid:7") -> dict[str, Any]:
        answer = self.service.set(values, who)
        return answer if isinstance(answer, dict) else {"promise": answer}
