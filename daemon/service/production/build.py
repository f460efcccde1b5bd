"""Production cell of a daemon, built from its configuration."""

from collections.abc import Callable, Mapping

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.recording.recorder import Recorder
from linemate.daemon.service.event_log import EventLog
from linemate.daemon.service.parameter_service import ParameterService
from linemate.daemon.service.production.production_cell import ProductionCell
from linemate.daemon.service.production.record_files import RecordFiles


def build_production(
    station: LoadedConfig,
    cycle: Cycle,
    variants: Mapping[str, Parameters],
    parameters: ParameterService,
    events: EventLog,
    recorder: Recorder | None,
    refusal: Callable[[str], str | None],
) -> ProductionCell | None:
    """Return the production cell, None if it is not configured.

    Args:
        variants: compiled tasks by variant.
        refusal: returns why an order is refused now, for reasons of the process.
    """
    settings = station.config.production
    if settings is None:
        return None
    directory = None if settings.records is None else station.path.parent / settings.records

    def use_task(compiled: Parameters, variant: str) -> None:
        parameters.follow(compiled)
        events.add(f"task {compiled.tracker.task.name} of variant {variant} is in force")

    def recorded_file() -> str | None:
        return recorder.status.file if recorder is not None and recorder.status.recording else None

    return ProductionCell(
        settings,
        cycle,
        variants,
        RecordFiles(directory, settings.days),
        refusal=refusal,
        on_event=events.add,
        on_task=use_task,
        recording=recorded_file,
    )
