"""Six recordings of an engine over a year while a leak grows: when is it found, one by one, by the history, together?

    python benchmarks/history.py --engines 4 --out DIR [--seed 61] [--minutes 5] [--together]

Every engine is the plant of the concealed benchmark's own-engine tier: maps off by 2 %, wear over the year, sensors of
its own, other weather and other driving in every recording. It is learned from twenty minutes, then recorded on six
days, once well and once with a leak that grows from nothing to 30 mm2 on the last day. Printed for each: what each
recording by itself, the history (`dieseltwin watch`), and with `--together` all recordings up to each day together say.
Stopped in the middle it goes on where it was.

    python benchmarks/history.py --out DIR --false-alarms 1000

draws histories of fifty recordings a year from the healthy recordings of these engines: errors of maps and sensors
from what is open of each engine, alike in a whole history, and noise from what the recordings showed beyond that, all
effects of a recording together and with a sign by chance. Printed: how many of the histories have an alarm.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import dieseltwin as dt
from dieseltwin.atomic import write_json
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.own_engine import (
    TIERS,
    draw_health,
    record_reference,
    same_sensors,
    weather,
    with_ambient,
    worn,
)
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.engine import we2011
from dieseltwin.learning.alarm import course
from dieseltwin.learning.history import Entry
from dieseltwin.settings.params import load_params

RECORDINGS = 6
LEAKS = ("boost_leak", "exhaust_leak")  # in turns
LARGEST_M2 = 30e-6
FIRST = datetime(2026, 1, 15, tzinfo=UTC)
APART = timedelta(days=73)
LABORATORY = we2011.PARAMETERS.model_dump()


def leak_of(number: int) -> str:
    """Which leak an engine has."""
    return LEAKS[number % len(LEAKS)]


def record(number: int, seed: int, minutes: float, folder: Path) -> None:
    """Write the recordings of one engine: reference_*.csv, healthy/DATE.csv, leaking/DATE.csv."""
    rng = np.random.default_rng([seed, number])
    then, wear = draw_health(LABORATORY, rng)
    maps, sensors = MapErrors.draw(TIERS["own-engine"], rng), SensorSet.draw(rng)
    first = run_plant(draw_driving("random", 60.0 * minutes, LABORATORY, rng), then, (), maps)
    for name in ("healthy", "leaking"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for k, frame in enumerate(record_reference(then, LABORATORY, maps, (sensors, first, 6), 20.0, rng)):
        frame.to_csv(folder / f"reference_{k + 1}.csv", index=False)
    for k in range(RECORDINGS):
        passed = k / (RECORDINGS - 1)
        now = worn(then, {name: 1.0 + passed * (share - 1.0) for name, share in wear.items()})
        today = weather(now, LABORATORY, rng)
        driving = draw_driving("random" if k % 2 == 0 else "whtc", 60.0 * minutes, LABORATORY, rng)
        faults = (Fault(leak_of(number), passed * LARGEST_M2),) if k else ()
        for name, present in (("healthy", ()), ("leaking", faults)):
            run = run_plant(driving, today, present, maps)
            frame = read(run, driving, present, same_sensors(sensors, first, run), 6, rng)
            with_ambient(frame, today).to_csv(folder / name / f"{FIRST + k * APART:%Y-%m-%d}.csv", index=False)


def engine_of(folder: Path) -> Path:
    """The learned engine of a folder, learned where it isn't yet."""
    mine = folder / "mine.yaml"
    if not mine.is_file():
        dt.learn(sorted(folder.glob("reference_*.csv"))).save(mine)
    return mine


def by_history(folder: Path, kind: str) -> pd.DataFrame:
    """Table of the history of one kind of recordings."""
    found = dt.watch(sorted((folder / kind).glob("*.csv")), engine_of(folder), folder / f"history_{kind}")
    print(f"{folder.name} {kind}: {found.sentence}", flush=True)
    return found.table()


def together(folder: Path, kind: str) -> dict[str, Any]:
    """What all recordings up to each day say together: day -> verdict, size on that day [m2], how it differs."""
    known = folder / f"together_{kind}.json"
    out: dict[str, Any] = json.loads(known.read_text()) if known.is_file() else {}
    files = sorted((folder / kind).glob("*.csv"))
    for count in range(len(files), 1, -1):
        if files[count - 1].stem in out:
            continue
        document = dt.discover(files[:count], engine_of(folder)).document
        last = document.recordings[-1].magnitudes
        out[files[count - 1].stem] = {
            "names": [list(effect.names) for effect in document.effects],
            "sizes": {name: [size.value, size.std] for name, size in last.items()},
            "over": [effect.over_recordings for effect in document.effects],
        }
        write_json(known, out)
    return out


def surprises(entries: Sequence[Entry]) -> tuple[list[str], np.ndarray]:
    """Effects, and how far each recording after the first was off those before, (R - 1, H) standard deviations."""
    names = sorted({score.name for entry in entries for score in entry.scores})
    columns = []
    for name in names:
        scores = [next(score for score in entry.scores if score.name == name) for entry in entries]
        shared = np.stack([score.shared for score in scores])
        covariance = shared @ shared.T + np.diag([score.noise_std**2 for score in scores])
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), [score.estimate for score in scores])
        columns.append(whitened[1:])
    return names, np.stack(columns, axis=1)


def false_alarms(folders: Sequence[Path], count: int, seed: int, a_year: int = 50, years: float = 1.0) -> None:
    """Print the share of healthy histories with an alarm, at the rate of the settings and at others."""
    rng = np.random.default_rng(seed)
    engines = [dt.history(folder / "history_healthy").entries for folder in folders]
    seen = [surprises(entries)[1] for entries in engines]
    names = surprises(engines[0])[0]
    noise = np.concatenate(seen)
    scatter, beyond = float(np.sqrt((noise**2).mean())), float(np.mean(np.abs(noise) > 2.58))
    print(f"{len(noise)} recordings, {len(names)} effects: scatter over what is stated {scatter:.3f}, "
          f"beyond 2.58 of it {beyond:.3f}")  # fmt: skip
    recordings = round(a_year * years)
    dates = [FIRST + timedelta(days=365.25 * years * k / recordings) for k in range(recordings)]
    settings = load_params().watch
    rates = (settings.alarms_per_year, 0.1, 0.5)
    alarms = np.zeros(len(rates))
    for _ in range(count):
        entries = engines[rng.integers(len(engines))]
        open_of_maps = rng.standard_normal(entries[0].scores[0].shared.size)
        history = []
        for _ in range(recordings):
            like = entries[rng.integers(len(entries))].scores
            odd = dict(zip(names, rng.choice((-1.0, 1.0)) * noise[rng.integers(len(noise))], strict=True))
            estimates = [score.shared @ open_of_maps + score.noise_std * odd[score.name] for score in like]
            history.append([replace(s, estimate=float(value)) for s, value in zip(like, estimates, strict=True)])
        largest = course(history, dates, settings).evidence.max()
        alarms += [largest >= 1.0 / rate for rate in rates]
    for rate, found in zip(rates, alarms, strict=True):
        print(f"stated {rate:g} a year: {found:.0f} alarms in {count} histories of {recordings} recordings")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engines", type=int, default=4)
    parser.add_argument("--only", type=int, help="number of the one engine to do")
    parser.add_argument("--seed", type=int, default=61)
    parser.add_argument("--minutes", type=float, default=5.0, help="length of every recording")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--together", action="store_true", help="also judge all recordings so far together")
    parser.add_argument("--false-alarms", type=int, help="number of healthy histories to draw")
    chosen = parser.parse_args(arguments)
    if chosen.false_alarms:
        false_alarms(sorted(chosen.out.glob("engine_*")), chosen.false_alarms, chosen.seed)
        return
    for number in range(chosen.engines) if chosen.only is None else [chosen.only]:
        folder = chosen.out / f"engine_{number}"
        if not (folder / "leaking").is_dir():
            record(number, chosen.seed, chosen.minutes, folder)
        for kind in ("healthy", "leaking"):
            shown = by_history(folder, kind)[["date", "evidence", "verdict"]]
            print(f"{leak_of(number)}, {kind}\n{shown.to_string(index=False)}", flush=True)
            if chosen.together:
                print(json.dumps(together(folder, kind), indent=1), flush=True)


if __name__ == "__main__":
    main()
