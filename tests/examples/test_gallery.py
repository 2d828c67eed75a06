"""The gallery's page shows the examples as they are now: whoever changes one runs `python examples/gallery.py`."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GALLERY = runpy.run_path(str(ROOT / "examples" / "gallery.py"))


@pytest.mark.parametrize("name", GALLERY["SCRIPTS"])
def test_the_page_holds_every_cell_with_its_output_and_figures(name: str) -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    code = [text for kind, text in GALLERY["cells"](ROOT / "examples" / name) if kind == "code"]
    assert len(code) >= 4
    for text in code:
        assert f"```python\n{text}\n```" in page, f"{name} has changed: run python examples/gallery.py"
        if "print(" in text:
            assert page.split(f"```python\n{text}\n```")[1].lstrip().startswith("```text\n")
    figures = list((ROOT / "docs" / "figures").glob(f"gallery_{Path(name).stem}_*.png"))
    assert figures and all(f"](figures/{figure.name})" in page for figure in figures)
