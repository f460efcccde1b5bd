"""Tables of the stored results of commissioning."""

from typing import Any

from docs.make import commission_results

STEPS = [
    {"cell": "wheel", "step": "object", "recordings": 3, "recorded_s": 134.6, "processor_s": 4.04,
     "measured": False, "reason": "too far off"},
    {"cell": "kr10", "step": "object", "recordings": 3, "recorded_s": 130.2, "processor_s": 3.0,
     "measured": True, "reason": ""},
    {"cell": "kr10", "step": "limits", "recordings": 0, "recorded_s": 0.0, "processor_s": 2.0,
     "measured": True, "reason": ""},
]  # fmt: skip
MOUNTINGS = [
    {"mounting": "camera turned", "cell": "wheel", "step": "camera", "off": {"mm": 0.4284}},
    {"mounting": "camera turned", "cell": "kr10", "step": "camera", "refused": "no", "written": 0},
]


def shown(table: Any, rows: list[dict[str, Any]]) -> list[str]:
    text: str = table(lambda _: {"rows": rows}, lambda _: True)
    return text.splitlines()


def test_a_step_has_the_times_of_both_cells_and_why_one_refused() -> None:
    _, _, place, limits = shown(commission_results.steps, STEPS)
    times = "135 (3 recordings) | 4.0 | 130 (3 recordings) | 3.0"
    assert place == f"| `object` | {times} | wheel refused: too far off |"
    assert limits == "| `limits` |  |  |  | 2.0 | measured |"


def test_a_mounting_has_its_error_or_its_refusal() -> None:
    _, _, row = shown(commission_results.mountings, MOUNTINGS)
    refused = "refused, nothing written: no"
    assert row == f"| camera turned | `camera` | found, 0.43 mm off | {refused} |"


def test_what_was_not_measured_says_so() -> None:
    for table in (commission_results.steps, commission_results.mountings):
        assert table(lambda _: {}, lambda _: False).startswith("Not measured yet: `make")
