"""The scripts of the front door run, on short recordings, and reach what they tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, folder: Path, minutes: float) -> dict[str, Any]:
    """A script's names after it ran over so many minutes; its files lie in `folder`."""
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    begin, end = text.index("FOLDER = "), text.index("\n", text.index("FOLDER = "))
    text = f"{text[:begin]}FOLDER = Path({str(folder)!r}){text[end:]}"
    assert "MINUTES = 10.0" in text
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(text.replace("MINUTES = 10.0", f"MINUTES = {minutes}"), name, "exec"), names)
    return names


@pytest.mark.thorough
def test_health_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = run("health_parameters.py", tmp_path, 2.0)
    assert (names["compared"]["off_by_std"].abs() < 4.0).all()
    assert "A_egrmax" in capsys.readouterr().out
    assert (tmp_path / "states.png").stat().st_size > 1000 and (tmp_path / "result" / "identification.json").is_file()


def test_from_file_to_repaired_twin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = run("from_file_to_repaired_twin.py", tmp_path, 2.5)
    assert "boost_leak" in names["found"].document.effects[0].names
    errors = names["errors"]
    assert errors["repaired"]["p_im_pa"] < 0.7 * errors["published"]["p_im_pa"]
    assert errors["repaired"]["p_im_pa"] < 1.3 * errors["noise"]["p_im_pa"]
    assert "The twin leaves out" in capsys.readouterr().out and (tmp_path / "discovery" / "report.html").is_file()
