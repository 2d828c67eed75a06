"""What every page of a machine has: curves to look into, a law typeset, nothing from outside, few bytes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from dieseltwin.report.encoding import drawn_here

LARGEST = 3_000_000
"""Bytes that a page may have."""


def groups_of(page: Path) -> list[dict[str, Any]]:
    """The groups of panels of a page, as its script reads them."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r'<script type="application/json" class="series">(.*?)</script>', text, re.DOTALL)
    return [json.loads(group) for group in found]


def check_page(page: Path, *laws: str) -> None:
    """Check a page in which these laws, as their letters, must be typeset."""
    text = page.read_text(encoding="utf-8")
    assert len(text.encode()) < LARGEST
    outside = re.sub(r'<script[^>]*>.*?</script>|src="data:[^"]*"', "", text, flags=re.DOTALL)
    assert not re.search(r"https?://|@import|url\(|<script|(?:src|href)=\"(?!#)", outside)
    panels = [panel for group in groups_of(page) for panel in group["panels"]]
    assert panels and all(len(line["y"]) == len(panel["x"]) for panel in panels for line in panel["lines"])
    assert all(a <= b for panel in panels for a, b in zip(panel["x"], panel["x"][1:], strict=False))
    assert text.count('class="still"') == len(groups_of(page))
    markups = re.findall(r"<math.*?</math>", text, re.DOTALL)
    formulae = [re.sub(r"<[^>]+>|&#x2061;|\s", "", markup) for markup in markups]
    for law in laws:
        assert any(law in formula for formula in formulae), law


@contextmanager
def without_pictures() -> Iterator[None]:
    """Figures are made and captioned as ever, and none is laid out and drawn, which is most of a command's page."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dieseltwin.report.page.encode_all", lambda figures, *_: {f.name: b"no picture" for f in figures})
        for module in ("discovery_page", "encoding"):
            patch.setattr(f"dieseltwin.report.{module}.drawn_in_two", drawn_here)
        yield
