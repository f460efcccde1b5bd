"""Results as JSON text, and the folder of a run's results.

Invariants:
    The same result gives the same bytes; no NaN, no infinity.
"""

import json
from pathlib import Path
from typing import Any

from linemate.simulators.judge.rows import Rows


def text(value: Any) -> str:
    """JSON of a result."""
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False)


def write(path: Path, value: Any) -> None:
    """Write JSON to a file, making its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text(value) + "\n", encoding="utf-8")


def write_results(out: Path, result: dict[str, Any], rows: Rows) -> None:
    """Write result.json, the report and its plots into a folder."""
    # matplotlib takes 0.5 s to import.
    from linemate.simulators.judge import report

    write(out / "result.json", result)
    report.write(out, result, rows)
