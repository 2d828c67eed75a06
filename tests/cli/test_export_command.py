"""What is given to `dieseltwin export` and would change nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from dieseltwin.cli.app import main


@pytest.mark.parametrize(("given", "said"), [
    (["--c", "x.c", "--fmi", "3"], "export --fmi: got no --fmu"),
    (["--table", "x", "--sources-only"], "export --sources-only: got no --fmu"),
    (["--c", "x.c", "--models", "models"], "export --models: got no --onnx"),
    (["we2011", "--onnx", "x"], "export ENGINE: got no --c, --fmu or --table"),
])  # fmt: skip
def test_an_option_without_what_it_belongs_to_is_refused(
    given: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", *given]) == 2
    assert said in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_options_of_an_fmu_that_is_asked_for_are_taken(tmp_path: Path) -> None:
    out = tmp_path / "engine.fmu"
    assert main(["export", "we2011", "--fmu", str(out), "--fmi", "3", "--sources-only"]) == 0 and out.exists()
