"""A caller of the front door as a user writes it, and as one does who is wrong: `make check` takes the first and
notices the second, whose lines say which error is expected (pyproject.toml)."""

from __future__ import annotations

from pathlib import Path

import dieseltwin as dt


def main() -> None:
    engine = dt.engine("we2011", A_egrmax=3.2e-4)
    recording = dt.read("drive.csv", channels="map.yaml", engine=engine)
    simulated = dt.simulate("drive.csv", engine, effects={"boost_leak": 3e-5})
    where: Path = simulated.save("out.parquet")
    found = dt.discover(recording, engine, withhold=["blow_by"], seed=1)
    sentence: str = found.sentence
    again = dt.simulate("drive.csv", found.engine)
    health = dt.identify("drive.csv", found.engine, method="classical", setup=dt.Setup(profile="paper"))
    calibrated = dt.calibrate("points.csv", geometry="geometry.yaml")
    implied = dt.imply("points.csv", "repaired.yaml")
    learned = dt.learn(["healthy.csv"], map_error=0.02)
    print(where, sentence, again.table(), health.table(), calibrated.engine, implied.plot(), learned.engine)
    dt.show_versions()


def wrong() -> None:
    dt.engin("we2011")  # type: ignore[attr-defined]
    found = dt.discover("drive.csv", seed="one")  # type: ignore[arg-type]
    sentence: int = found.sentence  # type: ignore[assignment]
    print(sentence, found.sentense, dt.identify())  # type: ignore[attr-defined, call-arg]
