"""Table of docs/production.md: a shift in virtual time."""

from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

from linemate.simulators.devices.line.cars import CarFault

Result = dict[str, Any]
Load = Callable[[str], Result]
Has = Callable[[str], bool]

COMMANDS = {
    "shift": "linemate-sim shift --cars 500 --seed 5 --workers 2 --minutes 90 --opc-ua --json"
}
ORDERS = ("arm", "start", "home", "retreat", "stop")
NOT_MEASURED = "Not measured yet: `make results NAME=shift`."


def condensed(raw: Result) -> Result:
    """Return the counts of a shift, and each car that was not mounted."""
    cars = raw["cars"]
    good = [car for car in cars if car["fault"] is None]
    mounted = [car for car in good if car["mounted"]]
    kinds = {
        str(kind): {
            "cars": sum(car["fault"] == kind for car in cars),
            "named": sum(car["fault"] == kind and car["cause_named"] for car in cars),
            "mounted": sum(car["fault"] == kind and car["mounted"] for car in cars),
        }
        for kind in CarFault
    }
    impacts = [car["impact_mm"] for car in mounted]
    forces = [car["force_n"] for car in mounted]
    return {
        "planned": raw["planned"],
        "cars": len(cars),
        "good_cars": len(good),
        "good_mounted": len(mounted),
        "faults": kinds,
        "collisions": raw["collisions"],
        "mounted_bad": raw["mounted_bad"],
        "unreported": raw["unreported"],
        "impact_mm": [median(impacts), max(impacts)],
        "force_n": [median(forces), max(forces)],
        "duration_s": raw["duration_s"],
        "requests": raw["requests"],
        "remembered_bytes": raw["remembered_bytes"],
        "resident_bytes": raw.get("resident_bytes", []),
        "record_bytes": raw["record_bytes"],
        "complaints": raw["complaints"],
        "not_mounted": [
            {name: car[name] for name in ("id", "variant", "fault", "outcome", "reason")}
            for car in cars
            if not car["mounted"]
        ],
    }


def table(load: Load, has: Has) -> str:
    """Return the figures of the stored shift, and a row for each car that was not mounted."""
    if not has("shift"):
        return NOT_MEASURED
    result = load("shift")
    orders = ", ".join(f"{op} {result['requests'].get(op, 0)}" for op in ORDERS)
    asked = ", ".join(
        f"{op} {count}" for op, count in result["requests"].items() if op not in ORDERS and count
    )
    daemons = len(result["remembered_bytes"])
    rows = (
        ("cars", f"{result['cars']} of {result['planned']} planned, [shift](results/shift.json)"),
        ("virtual time, daemons", f"{result['duration_s'] / 3600.0:.2f} h, {daemons}"),
        ("good cars mounted", f"{result['good_mounted']} of {result['good_cars']}"),
        *((f"{kind}: cause reported", _named(counts)) for kind, counts in result["faults"].items()),
        ("collisions; good record of a car that is not mounted; no record",
         f"{result['collisions']}; {result['mounted_bad']}; {result['unreported']}"),
        ("error at the touch, median and largest", _pair(result["impact_mm"], "mm", 2)),
        ("largest force, median and largest", _pair(result["force_n"], "N", 0)),
        ("orders of the line's controller", orders),
        ("its other requests", asked),
        ("what the daemon remembers, first and last car", _sizes(result["remembered_bytes"])),
        ("memory of the process, first and last car", _sizes(result["resident_bytes"])),
        ("record files", f"{result['record_bytes'] / result['cars'] / 1e3:.1f} kB a car"),
    )  # fmt: skip
    lines = ["| what | figure |", "|---|---|", *(f"| {what} | {text} |" for what, text in rows)]
    lines += ["", "| not mounted | fault | reported |", "|---|---|---|"]
    lines += [
        f"| {car['id']} {car['variant']} | {car['fault'] or 'none'} | {car['reason']} |"
        for car in result["not_mounted"]
    ]
    return "\n".join(lines)


def _named(counts: Mapping[str, int]) -> str:
    return f"{counts['named']} of {counts['cars']}"


def _pair(values: list[float], unit: str, digits: int) -> str:
    return f"{values[0]:.{digits}f} {unit}, {values[1]:.{digits}f} {unit}"


def _sizes(sizes: list[list[int]]) -> str:
    known = [(first, last) for first, last in sizes if first]
    return "; ".join(f"{a / 1e6:.2f} MB, {b / 1e6:.2f} MB" for a, b in known) or "not measured"
