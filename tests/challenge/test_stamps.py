"""What was kept is known by the code that made it."""

from __future__ import annotations

from pathlib import Path

import pytest

from dieseltwin.challenge import stamps


def test_code_counts_and_words_about_it_do_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stamps, "_PACKAGE", tmp_path)
    module = tmp_path / "room" / "module.py"
    module.parent.mkdir()
    found = []
    for text in ('"""Words."""\nx = 1\n', '"""Other words."""\nx = 1  # one\n', '"""Words."""\nx = 2\n'):
        module.write_text(text)
        stamps.code_sha256.cache_clear()
        found.append((stamps.code_sha256("room"), stamps.code_sha256("room/module.py")))
    stamps.code_sha256.cache_clear()
    assert found[0] == found[1] != found[2]
