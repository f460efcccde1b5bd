"""Results as JSON text, the same bytes for the same result.

Law of this file: no NaN, no infinity, order as made, a newline at the end of a file.
"""

import json
from pathlib import Path
from typing import Any


def text(value: Any) -> str:
    """JSON of a result."""
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False)


def write(path: Path, value: Any) -> None:
    """Write JSON to a file, making its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text(value) + "\n", encoding="utf-8")
