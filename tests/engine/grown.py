"""Two patches of the library: a new effect is one file, a new sensor column one row and the words of its names."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

EFFECT = """
from dieseltwin.engine.effect import Curve, Effect, Entry

K = 2000.0  # rpm


def swirl_loss(eta_vol, k, n_e):
    return eta_vol * (1.0 - k * n_e / K)


EFFECT = Effect(
    name="swirl_loss", site="cylinder_flow", enters=Entry("quantity", "eta_vol"), change=swirl_loss,
    law="eta_vol (1 - k n_e/2000 rpm)", symbol="k", unit="-", tolerance=0.01, limits=(0.0, 0.4),
    curve=Curve("n_e"), phrase="a loss by swirl of {m} at 2000 rpm", source="a test",
)
"""
SENSOR = """    Sensor(
        "T_c", 0.01, 1.0, 400.0, (GAIN, Fault("offset", 3.0, 60.0)),
        "a compressor that lost efficiency must be worse to show",
        needed=False,
    ),
"""
END_OF_SENSORS = ")  # fmt: skip\n"
MEANING = r"""meanings:
  compressor outlet temperature:
    column: t_c_k
    units: [temperature]
    says:
      0.95:
        - '\b(after|behind|nach) (compressor|verdichter)\b'
    rules_out: '\b<PRESSURE>\b|<WANTED>'
"""


def write_effect(library: Path) -> None:
    """`swirl_loss`, one file."""
    (library / "engine" / "effects" / "swirl_loss.py").write_text(EFFECT, encoding="utf-8")


def write_sensor(library: Path) -> None:
    """The temperature behind the compressor, `t_c_k`: a row of the table of sensors, and the words that names have."""
    _inserted(library / "sensors.py", END_OF_SENSORS, SENSOR + END_OF_SENSORS)
    _inserted(library / "data" / "channel_names.yaml", "meanings:\n", MEANING)


def _inserted(file: Path, place: str, text: str) -> None:
    before = file.read_text(encoding="utf-8")
    assert before.count(place) == 1, place
    file.write_text(before.replace(place, text), encoding="utf-8")


def copied(root: Path, folder: Path) -> Path:
    """A copy of the library of a checkout in a folder."""
    ignored = shutil.ignore_patterns("__pycache__")
    return Path(shutil.copytree(root / "dieseltwin", folder / "dieseltwin", ignore=ignored))


def differences(library: Path, other: Path) -> Iterator[str]:
    """Files of `other` that are new or differ from the library's."""
    for file in sorted(path for path in other.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
        name = file.relative_to(other)
        if not (library / name).is_file() or (library / name).read_bytes() != file.read_bytes():
            yield name.as_posix()
