"""Tables of docs/world.md, and what README.md and docs/accuracy.md say of the plant floor."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from docs.make.figures import number
from linemate.simulators.harness import scenario_file
from linemate.simulators.harness.world import world_rows
from linemate.simulators.lab.world.world_table import outcomes

Result = dict[str, Any]
Load = Callable[[str], Result]
Has = Callable[[str], bool]

FLOOR, HARSH = "plant-floor", "plant-floor-harsh"
MEASURED = "plant-floor-measured"
MUJOCO = "mujoco"
SCENARIOS = f"{FLOOR},{HARSH}"

IDENTIFIED = {
    "world-windup": ("windup-1mrad,windup-10mrad", "--identified 2 --seeds 0..9"),
    "world-learnt": (
        "hand-eye-2mm,distance-slip-1pct,distance-late-20ms,six-moderate,six-harsher",
        "--identified 2 --learnt 3 --seeds 0..1",
    ),
}
"""Rows, and how they were measured, of cells that were identified before their runs."""

COMMANDS = {
    "world-before": "linemate-sim world --seeds 0..1 --json",
    "world": "linemate-sim world --seeds 0..1 --json",
    "plant-floor": f"linemate-sim world --rows {SCENARIOS} --seeds 0..39 --json",
    "plant-floor-verified": f"linemate-sim world --rows {SCENARIOS} --seeds 1000..1099 --json",
    MEASURED: f"linemate-sim world --rows {MEASURED} --seeds 0..39 --json",
    "plant-floor-4ms": f"linemate-sim world --rows {FLOOR} --seeds 0..39 --cycle-ms 4 --json",
    **{
        name: f"linemate-sim world --rows {listed} {how} --json"
        for name, (listed, how) in IDENTIFIED.items()
    },
    MUJOCO: f"linemate-sim world --world mujoco --rows {MUJOCO} --seeds 0..39 --json",
}

NOT_MEASURED = "Not measured yet: `make results NAME=plant-floor`."

MILLI, MICRO = 1e3, 1e6
ESTIMATE = "estimate"
SEEN = "seen in an independent cell in MuJoCo"

SIZES: tuple[tuple[str, str, float, str, str], ...] = (
    ("robot.effects.windup.depth", "windup to each side", MILLI, "mrad",
     "recordings of a KUKA KR300: 0 to 0.1 mrad on A1-A3 if the stamps of motor and link encoders"
     " are aligned, 0.4 to 0.7 mrad if not; law: Dahl 1968"),
    ("robot.effects.lost_motion", "lost motion", MILLI, "mrad",
     "0.1 to 0.3 mrad of worn gears; a quarter of that for gears in order"),
    ("robot.effects.friction.coulomb", "following error by friction", MILLI, "mrad",
     "0.1 to 0.3 mrad of large arms; the integral action takes about half"),
    ("robot.effects.elasticity.compliance", "compliance of gears", MICRO, "urad/Nm",
     "Dumas, Caro, Garnier, Furet 2011: 4e6 and 5e5 Nm/rad"),
    ("robot.effects.geometry.zero_sigma", "zero of an axis, one sigma", MILLI, "mrad",
     "0.3 mrad uncalibrated (ISO 9283 absolute accuracy 0.3 to 1 mm); a third calibrated"),
    ("robot.effects.geometry.length_sigma", "length of a link, one sigma", MILLI, "mm", "the same"),
    ("robot.effects.geometry.angle_sigma", "twist of a link, one sigma", MILLI, "mrad", "the same"),
    ("robot.effects.posture.frequency_share", "servo frequency by reach", 1.0, "1/m", ESTIMATE),
    ("robot.effects.posture.dead_time_amplitude", "drift of the dead time", MILLI, "ms",
     "estimate; 84 to 180 ms drifting are reported of FANUC"),
    ("robot.effects.quantisation", "encoder step", MICRO, "urad", "1e-4 degrees in RSI's text"),
    ("conveyor.effects.askew", "direction, to the car and upwards", MILLI, "mrad",
     "1 to 10 mrad, the lower end for a surveyed line"),
    ("conveyor.effects.sag", "sag between supports 3 m apart", MILLI, "mm", "mm over metres"),
    ("conveyor.effects.ramp_s", "build-up of an acceleration", 1.0, "s",
     "S-shaped ramps of frequency converters, 0.1 to 0.5 s"),
    ("conveyor.effects.coast_s", "coasting of a stop, time constant", 1.0, "s", "0.1 to 0.5 s"),
    ("conveyor.effects.creep_speed", "creep while stopped", MILLI, "mm/s", ESTIMATE),
    ("conveyor.effects.stick_slip", "step of stick-slip at a start", MILLI, "mm", ESTIMATE),
    ("conveyor.effects.teeth", "teeth of the sprocket, pitch 100 mm", 1.0, "",
     "polygon effect, v = R w cos(phi): +-0.2 mm with 12 teeth"),
    ("body.carrier.0.frequency_hz", "car along the line", 1.0, "Hz",
     f"swings by +-2.7 mm at 1.2 Hz after a stop, {SEEN}"),
    ("body.carrier.0.mass", "its modal mass", 1.0, "kg", f"900 kg, {SEEN}; 100 to 2000 kg"),
    ("body.carrier.1.frequency_hz", "car across the line, a fifth of the excitation", 1.0, "Hz",
     ESTIMATE),
    ("body.carrier.1.mass", "its modal mass", 1.0, "kg", "100 to 2000 kg"),
    ("contact.mating.bolts", "bolts on a circle of 112 mm, chamfer 1.5 mm", 1.0, "",
     "common for cars; chamfers of 1 to 2 mm"),
    ("contact.mating.angle_range", "their angle off by up to", MILLI, "mrad", "2 degrees at most"),
    ("contact.mating.friction", "friction in contact", 1.0, "", "0.1 to 0.3"),
    ("effector.load.wheel_mass", "wheel on the mount", 1.0, "kg",
     "20 to 28 kg, makers' catalogues; the harsh one is that of a light truck"),
    ("effector.load.wheel_mass_spread", "its spread over the cars", 1e2, "%", ESTIMATE),
    ("force_torque.effects.bias_force", "bias of a force, at most", 1.0, "N",
     "2 to 10 N after mounting"),
    ("force_torque.effects.bias_torque", "bias of a torque, at most", 1.0, "Nm", "0.2 to 1 Nm"),
    ("force_torque.effects.drift_force", "drift of a force over 10 min", 1.0, "N",
     "0.1 % of full scale a kelvin: 1 to 5 N"),
    ("force_torque.effects.drift_torque", "drift of a torque", 1.0, "Nm", "the same"),
    ("distance.delay_s", "delay of the distance sensor, 1 ms stated", MILLI, "ms",
     "dated 5 to 20 ms late"),
    ("distance.effects.slip", "slip of the measuring wheel", 1e2, "%", "0.1 to 1 %"),
    ("distance.effects.drift", "drift of the reading", MILLI, "mm/sqrt(s)", ESTIMATE),
    ("camera.blind_below", "camera blind below", MILLI, "mm", "60 to 100 mm"),
    ("camera.effects.depth_bias", "range bias", MILLI, "mm/m", "1 to 5 mm/m"),
    ("camera.effects.lateral_bias", "lateral bias", MILLI, "mm/m", ESTIMATE),
    ("camera.effects.correlated_sigma", "correlated noise at distance 0", MILLI, "mm",
     "half of the white noise; correlated over 0.1 to 1 s"),
    ("camera.effects.correlated_sigma_per_metre", "its growth", MILLI, "mm/m", "the same"),
    ("camera.effects.correlated_rotation", "correlated noise of orientation", MILLI, "mrad",
     "the same"),
    ("camera.effects.blind_before_contact_s", "hidden by the wheel before contact", 1.0, "s",
     "occlusion by the wheel; 0.5 s in a row of its own"),
    ("camera.effects.view_limit", "no image gives a pose beyond a view angle of", 1.0, "rad",
     ESTIMATE),
    ("camera.effects.stamp_bias_s", "stamps late", MILLI, "ms", "off by 5 to 20 ms"),
    ("camera.effects.stamp_jitter_s", "stamps off at random, half width", MILLI, "ms", ESTIMATE),
    ("camera.effects.exposure_time_s", "exposure", MILLI, "ms", "1 to 5 ms"),
    ("camera.effects.mount_offset", "hand-eye, each axis", MILLI, "mm", "0.5 to 2 mm in all"),
    ("camera.effects.mount_rotation", "hand-eye, each axis", MILLI, "mrad", "1 to 3 mrad in all"),
)  # fmt: skip
"""Path of each size of the plant floor, its name, its unit, and where it comes from."""

BARS: tuple[tuple[str, str, str], ...] = (
    ("control_mm", "control error before contact, mm", "0.5"),
    ("impact_mm", "total error at impact, mm", "0.35 (0.8)"),
    ("stop_mm", "total error after a stop, mm", "2.2 (3.4)"),
    ("start_s", "start confirmed, s", ""),
    ("force_n", "contact force, N", "90 (130)"),
)


WINDUP_BARS, LEARNT_BARS = ("0.5", "0.4"), ("", "0.49")
"""What is asked of the medians of control and impact [mm]; 0.49 is twice that of `nominal`."""


def condensed(raw: Result) -> Result:
    """Return each row's summary, and each run that was not assembled."""
    return {
        name: {
            "what": row["what"],
            "summary": row["summary"],
            "not_assembled": [
                {key: run[key] for key in ("seed", "outcome", "reason")}
                for run in row["runs"]
                if run["outcome"] != "assembled"
            ],
        }
        for name, row in raw["rows"].items()
    }  # fmt: skip


def sizes() -> str:
    """Return the table of sizes and sources of the plant floor."""
    floor, harsh = (scenario_file.to_plain(scenario_file.load(name)) for name in (FLOOR, HARSH))
    lines = ["| effect | plant floor | harsh | source or range |", "|---|---|---|---|"]
    for path, label, scale, unit, source in SIZES:
        moderate, high = (_size(_at(plain, path), scale) for plain in (floor, harsh))
        lines.append(f"| {label} | {moderate} {unit} | {high} {unit} | {source} |")
    return "\n".join(lines)


def _at(plain: Any, path: str) -> Any:
    for part in path.split("."):
        plain = plain[int(part)] if part.isdigit() else plain[part]
    return plain


def _size(value: Any, scale: float) -> str:
    values = value if isinstance(value, list) else [value]
    return ", ".join(dict.fromkeys(f"{float(f'{v * scale:.3g}'):g}" for v in values))


def rows(load: Load, has: Has) -> str:
    """Return the table of every row, before and now."""
    before, now = (load(name) if has(name) else {} for name in ("world-before", "world"))
    lines = [
        "| row | what the plant does | before: runs | impact, mm | force, N | false confirmed"
        " | now: runs | control, mm | impact, mm | stop, mm | start, s | force, N"
        " | false confirmed |",
        "|---" * 13 + "|",
    ]
    listed = (*world_rows.rows(), FLOOR, HARSH)
    for name in (name for name in listed if name in now or name in before):
        what = world_rows.rows()[name].what if name in world_rows.rows() else "all effects"
        cells = (
            *_cells(before.get(name), ("impact_mm", "force_n")),
            *_cells(now.get(name), ("control_mm", "impact_mm", "stop_mm", "start_s", "force_n")),
        )
        lines.append(f"| {name} | {what} | " + " | ".join(cells) + " |")
    stored = [name for name in ("world-before", "world") if has(name)]
    links = ", ".join(f"[{name}](results/{name}.json)" for name in stored)
    return "\n".join([*lines, "", f"Results: {links}."])


def identified(load: Load, has: Has) -> str:
    """Return the table of rows whose cells were identified, and learned from some cars."""
    lines = [
        "| row | seeds | runs | impact without, mm | control, mm | impact, mm | asked of control"
        " | asked of impact | force, N | false confirmed |",
        "|---" * 10 + "|",
    ]
    without = load("world") if has("world") else {}
    for result, (listed, how) in IDENTIFIED.items():
        rows_of = load(result) if has(result) else {}
        for name in (name for name in listed.split(",") if name in rows_of):
            summary = rows_of[name]["summary"]
            plain = without.get(name, {}).get("summary", {}).get("impact_mm")
            control, impact = LEARNT_BARS if "--learnt" in how else WINDUP_BARS
            cells = (
                f"[{name}](results/{result}.json)",
                summary["seeds"],
                outcomes(summary),
                _spread(plain),
                _spread(summary["control_mm"]),
                _spread(summary["impact_mm"]),
                control,
                impact,
                _spread(summary["force_n"]),
                str(summary["false_confirmed"]),
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _cells(row: Mapping[str, Any] | None, keys: tuple[str, ...]) -> Iterator[str]:
    if row is None:
        yield from ("-",) * (len(keys) + 2)
        return
    summary = row["summary"]
    yield outcomes(summary)
    yield from (_spread(summary[key]) for key in keys)
    yield str(summary["false_confirmed"])


def _spread(figure: Mapping[str, Any] | None) -> str:
    if figure is None:
        return "-"
    return f"{_number(figure['median'])} ({_number(figure['worst'])})"


def _number(value: float | None) -> str:
    return "missed" if value is None else number(value)


def floor(load: Load, has: Has) -> str:
    """Return the table of the plant floor against what is asked of it."""
    columns = (
        ("12 ms", "plant-floor", FLOOR),
        ("12 ms, arm measured", MEASURED, MEASURED),
        ("12 ms, seeds 1000-1099", "plant-floor-verified", FLOOR),
        ("4 ms", "plant-floor-4ms", FLOOR),
        ("harsh, 12 ms", "plant-floor", HARSH),
        ("harsh, seeds 1000-1099", "plant-floor-verified", HARSH),
    )
    columns = tuple(column for column in columns if has(column[1]))
    if not columns:
        return NOT_MEASURED
    summaries = [load(name)[scenario]["summary"] for _, name, scenario in columns]
    links = [f"[{head}](results/{name}.json)" for head, name, _ in columns]
    lines = [
        "| figure | asked of 12 ms | " + " | ".join(links) + " |",
        "|---" * (len(columns) + 2) + "|",
        "| runs | 100 % assembled | " + " | ".join(map(outcomes, summaries)) + " |",
    ]
    for key, label, bar in BARS:
        cells = (_spread(summary[key]) for summary in summaries)
        lines.append(f"| {label} | {bar} | " + " | ".join(cells) + " |")
    alarms = (str(summary["false_confirmed"]) for summary in summaries)
    return "\n".join([*lines, "| false confirmed alarms | 0 | " + " | ".join(alarms) + " |"])


def second(load: Load) -> str:
    """Return the table of the MuJoCo station against what is asked of it."""
    summary = load(MUJOCO)[MUJOCO]["summary"]
    lines = [
        f"| figure | asked | [measured](results/{MUJOCO}.json) |",
        "|---|---|---|",
        f"| runs | 100 % assembled | {outcomes(summary)} |",
    ]
    bars = {"impact_mm": "0.5"}
    for key, label, _ in BARS:
        lines.append(f"| {label} | {bars.get(key, '')} | {_spread(summary[key])} |")
    return "\n".join([*lines, f"| false confirmed alarms | | {summary['false_confirmed']} |"])


def readme(load: Load, has: Has) -> list[tuple[str, str, str]]:
    """Return what README.md says first: what was measured, the figures, the result's name."""
    figure_rows: list[tuple[str, str, str]] = []
    if not has("plant-floor"):
        return figure_rows
    for label, scenario in (("a plant floor", FLOOR), ("a harsh one", HARSH)):
        summary = load("plant-floor")[scenario]["summary"]
        figures = (
            f"{outcomes(summary)}; {_spread(summary['impact_mm'])} mm at impact,"
            f" {_spread(summary['force_n'])} N; false alarms: {summary['false_confirmed']}"
        )
        figure_rows.append((f"{label}, {summary['runs']} objects, 12 ms", figures, "plant-floor"))
    if has(MUJOCO):
        summary = load(MUJOCO)[MUJOCO]["summary"]
        figures = f"{outcomes(summary)}; {_spread(summary['impact_mm'])} mm at impact"
        figure_rows.append(("a station in MuJoCo, 12 ms", figures, MUJOCO))
    return figure_rows
