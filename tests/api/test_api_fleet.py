"""Histories of many engines side by side: order, words, pages, and what can't be read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import dieseltwin as dt
from dieseltwin.cli.app import main
from dieseltwin.errors import InputError
from dieseltwin.learning.history import FILE_NAME, Entry, History
from tests.learning.test_history import ENGINE, entry


def leaking(k: int, size: float) -> Entry:
    """A recording whose boost leak [m2] its score and its own refit show; none where it is 0."""
    (score,) = entry(k).scores
    score = replace(score, estimate=size, noise_std=1e-6, shared=0.0 * score.shared)
    healthy = replace(entry(k), date=f"2026-{2 * k + 1:02d}-01T00:00:00+00:00", scores=(score,))
    return healthy if not size else replace(healthy, verdict="boost_leak", sizes={"boost_leak": (size, 0.3e-6)})


@pytest.fixture
def lorries(tmp_path: Path) -> list[Path]:
    """One that is well, one that leaks, one whose last recording alone leaks, one that was mended; and a broken one."""
    sizes = {"well": [0.0] * 4, "leaks": [0.0, 0.0, 20e-6, 20e-6], "once": [0.0, 0.0, 0.0, 20e-6],
             "mended": [0.0, 20e-6, 20e-6, 0.0]}  # fmt: skip
    for name, some in sizes.items():
        for k, size in enumerate(some):
            History(tmp_path / name, ENGINE).add(leaking(k, size))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / FILE_NAME).write_bytes(b"x" * 5000)
    return [tmp_path / name for name in (*sizes, "broken")]


def test_engines_that_call_for_somebody_come_first(lorries: list[Path], tmp_path: Path):
    found = dt.fleet(lorries)
    table = found.table()
    assert table["engine"].tolist() == ["leaks", "once", "mended", "well"]
    assert table["state"].tolist() == ["alarm", "last recording shows something", "was an alarm, is gone",
                                       "no change but wear"]  # fmt: skip
    assert table["about"][0] == "boost_leak, 20.00 ± 0.30 mm² on 2026-07-01, there since 2026-05-01"
    assert table["about"][1] == "boost_leak, 20.00 ± 0.30 mm²"
    assert table["size"][0] == 20e-6 and table["size_std"][0] == 0.3e-6 and table["alarm_on"][0][:10] == "2026-07-01"
    assert found.sentence.startswith("1 of 4 engines has an alarm: leaks (boost_leak); ")
    assert "alone shows something of 1: once (boost_leak)" in found.sentence
    assert "gone of mended" in found.sentence and "up to 0.08 a year" in found.sentence
    assert found.refused[0][0].endswith("broken") and "broken: not read: " in "\n".join(found.lines())
    assert len(found.plot().axes) == 4 and "<table" in found._repr_html_()
    for name, one in found.engines.items():  # as each says it by itself
        assert one.sentence == dt.history(tmp_path / name).sentence
    found.save(tmp_path / "out")
    text = (tmp_path / "out" / "fleet.html").read_text(encoding="utf-8")
    assert '<a href="leaks/history.html">leaks</a>' in text and (tmp_path / "out" / "leaks" / "history.html").is_file()
    order = [text.index(f'href="{name}/history.html"') for name in ("leaks", "once", "mended", "well")]
    assert order == sorted(order)
    assert dt.fleet(lorries[::-1]).table().equals(table)


def test_a_fleet_by_the_command(lorries: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["watch", "fleet", *map(str, lorries), "--out", str(tmp_path / "out")]) == 2  # one can't be read
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("leaks: alarm: boost_leak, 20.00 ± 0.30 mm²") and said[3] == "well: no change but wear"
    assert (tmp_path / "out" / "fleet.csv").is_file()
    assert main(["watch", "fleet", *map(str, lorries[:4]), "--alarms-per-year", "0.5"]) == 0
    assert "up to 2 a year" in capsys.readouterr().out
    assert main(["watch", "fleet", str(lorries[4])]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_engines_of_one_name_are_told_by_the_folder_above(tmp_path: Path):
    for place in ("north", "south"):
        History(tmp_path / place / "lorry", ENGINE).add(leaking(0, 0.0))
    assert list(dt.fleet([tmp_path / "north" / "lorry", tmp_path / "south" / "lorry"]).engines) == [
        "north-lorry", "south-lorry"]  # fmt: skip
    with pytest.raises(InputError, match="the same history twice"):
        dt.fleet([tmp_path / "north" / "lorry", f"{tmp_path}/north/../north/lorry"])
    with pytest.raises(InputError, match="nothing"):
        dt.fleet([])
