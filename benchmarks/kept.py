"""Results of a benchmark as lines of JSON in a file that goes on where it was stopped."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def kept_lines(path: Path) -> list[dict[str, Any]]:
    """What a file holds already, none where there is no file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def keep(path: Path, row: Mapping[str, Any]) -> None:
    """Append a result."""
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{json.dumps(row)}\n")
