"""Commands that leave one folder a question, run once a session and read by many tests."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from dieseltwin.cli.app import main
from dieseltwin.discovery.verdict.document import Discrepancy, load_discrepancy
from tests.pages import without_pictures


@dataclass(frozen=True)
class Answer:
    """What a command wrote."""

    folder: Path

    @property
    def document(self) -> Discrepancy:
        """The verdict, read back from its file."""
        return load_discrepancy(self.folder)

    @property
    def details(self) -> dict[str, Any]:
        """What stands beside it."""
        return dict(json.loads((self.folder / "details.json").read_text(encoding="utf-8")))


Ask = Callable[..., Answer]


@pytest.fixture(scope="session")
def ask(tmp_path_factory: pytest.TempPathFactory) -> Ask:
    """`dieseltwin discover RECORDING ... --out FOLDER`, which must succeed; of a leak its page has pictures."""

    def run(recording: Path, *options: str | Path) -> Answer:
        out = tmp_path_factory.mktemp("found") / recording.stem
        with nullcontext() if recording.stem == "leak" else without_pictures():
            assert main(["discover", str(recording), *(str(option) for option in options), "--out", str(out)]) == 0
        return Answer(out)

    return run
