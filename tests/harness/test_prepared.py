"""A whole approach in virtual time, once with replies made in line and once made beforehand."""

from dataclasses import replace

from linemate.daemon.cycle.step_log import LogEntry
from linemate.simulators.harness import setup
from linemate.simulators.harness.lockstep import Lockstep


def approach(*, prepared: bool) -> tuple[Lockstep, list[LogEntry]]:
    made = setup.make("wheel", cycle_ms=12.0)
    made = replace(made, scenario=replace(made.scenario, lead_in_s=1.3, duration_s=2.5))
    entries: list[LogEntry] = []
    run = Lockstep(made, seed=2, on_step=entries.append)
    in_line = run.cycle.on_telegram

    def on_telegram(data: bytes, stamp_ns: int) -> bytes | None:
        run.cycle.prepare(stamp_ns)
        ready = run.cycle.ready_reply
        early = ready.data if ready is not None and ready.telegram.matches(data) else None
        reply = in_line(data, stamp_ns)
        assert early in {None, reply}
        return reply

    if prepared:
        run.cycle.on_telegram = on_telegram  # type: ignore[method-assign, assignment]
    while run.turn():
        pass
    return run, entries


def test_a_prepared_approach_gives_the_commands_of_one_in_line() -> None:
    in_line_run, in_line = approach(prepared=False)
    prepared_run, prepared = approach(prepared=True)
    assert in_line[-1].state == "track"
    assert prepared_run.cycle.prepared >= 0.99 * len(prepared)
    assert in_line_run.cycle.prepared == 0
    assert [entry.outputs.command for entry in prepared] == [
        entry.outputs.command for entry in in_line
    ]
