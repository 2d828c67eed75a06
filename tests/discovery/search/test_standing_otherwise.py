"""A valve that stands still and leaves far too much gives way to the search without it, where that leaves less."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from dieseltwin.discovery import discover as module
from dieseltwin.discovery.options import Options


@pytest.mark.parametrize(
    ("valve", "otherwise", "chosen", "searches"),
    [(1.15, 1.0, "valve", 1), (1.9, 1.1, "otherwise", 2), (6.0, 9.0, "valve", 2), (6.0, None, "valve", 1)],
)
def test_whichever_leaves_less(
    monkeypatch: pytest.MonkeyPatch, valve: float, otherwise: float | None, chosen: str, searches: int
) -> None:
    left = {"valve": valve, "otherwise": otherwise}
    run: list[str] = []

    def carry_on(found: Any, **_: Any) -> Any:
        run.append(found)
        return found

    monkeypatch.setattr(module.search, "carry_on", carry_on)
    monkeypatch.setattr(module, "share_left", lambda found: left[found])
    begun = [SimpleNamespace(anew=lambda name=name: name) for name in left]
    prepared = module.Prepared(cast(Any, begun[0]), None if otherwise is None else cast(Any, begun[1]))
    assert module._found(prepared, Options(), None) == chosen
    assert len(run) == searches
