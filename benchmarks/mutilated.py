"""What `identify` says of recordings that were mutilated on purpose, and of clean ones.

    python benchmarks/mutilated.py --cases 100 --seed 1
    python benchmarks/mutilated.py --only clean --cases 100 --seed 1

A case is five minutes of random driving of an engine with other health parameters (`datasets.make_validation`), with
the paper's noise or three tenths of it, and one fault of one channel (or of the clock) of random severity. Counted are
crashes, refusals, and health parameters that are wrong by more than 5 % and by more than 4 of the standard deviations
that `identify` states, with and without a warning in the file; and warnings on clean recordings.
"""

from __future__ import annotations

import argparse
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from kept import keep

import dieseltwin as dt
from dieseltwin.engine import HEALTH, MEASURED
from dieseltwin.errors import InputError
from dieseltwin.paper.datasets import make_validation
from dieseltwin.settings.params import load_params

SECONDS, STEP_S, PARTS = 300.0, 0.2, 4
NOISE = (0.03, 0.03, 0.01, 0.05, 0.03)  # of each sensor's mean: the paper's
LEVELS = (1.0, 0.3)
SENSORS = MEASURED[:5]
INPUTS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
CHANNELS = (*SENSORS, *INPUTS)
WRONG, SIGMAS = 0.05, 4.0

Mutilated = tuple[pd.DataFrame, str]
"""A damaged recording, and how badly."""

Mutilation = Callable[[pd.DataFrame, str, np.random.Generator], Mutilated]


@dataclass(frozen=True)
class Verdict:
    """What became of one case.

    Attributes:
        seed, kind, channel, severity: of the case; kind "clean" without a fault.
        end: "answer", "refused" or "crash".
        codes: of the warnings in the file.
        errors: relative error of each health parameter, 0 where none is given [-].
        sigmas: the same over the stated standard deviation.
        seconds: wall time [s].
        text: the refusal, the crash, or the first warning.
    """

    seed: int
    kind: str
    channel: str
    severity: str
    end: str
    codes: tuple[str, ...]
    errors: tuple[float, ...]
    sigmas: tuple[float, ...]
    seconds: float
    text: str

    @property
    def wrong(self) -> bool:
        """Whether a parameter is wrong by more than 5 % and more than it admits."""
        return any(abs(e) > WRONG and abs(s) > SIGMAS for e, s in zip(self.errors, self.sigmas, strict=True))

    @property
    def silent(self) -> bool:
        """Wrong without any warning in the file."""
        return self.wrong and not self.codes


def clean_recordings(seed: int, first: int = 0) -> Iterator[tuple[int, pd.DataFrame, np.ndarray]]:
    """Endless clean recordings with their numbers and health parameters, from the set that holds number `first`."""
    params = load_params(None, "quick")
    number = first - first % PARTS
    while True:
        frame, true = make_validation(100_000 + 1_000 * seed + number // PARTS, params)
        for part in range(PARTS):
            since = part * SECONDS
            rows = (frame["time_s"] >= since - 0.01) & (frame["time_s"] <= since + SECONDS + 0.01)
            kept = frame.loc[rows, ["time_s", *CHANNELS, "t_amb_k", "p_amb_pa"]].reset_index(drop=True)
            kept["time_s"] -= since
            rng = np.random.default_rng([seed, number])
            level = LEVELS[number % len(LEVELS)]
            for name, share in zip(SENSORS, NOISE, strict=True):
                kept[name] += level * share * kept[name].mean() * rng.standard_normal(len(kept))
            yield number, kept, np.asarray(true.health())
            number += 1


def drop(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """Rows are lost and the time stamps made anew, as by a logger that counts rows."""
    share = rng.uniform(0.02, 0.2)
    lost = frame.index[rng.random(len(frame)) < share]
    frame = frame.drop(index=lost)
    frame["time_s"] = STEP_S * np.arange(len(frame))
    return frame, f"{share:.0%} of the rows"


def swap(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """Two channels stand under each other's name; the paper's likeliest mix-ups are pressures and positions."""
    pairs = (("p_im_pa", "p_em_pa"), ("u_egr_pct", "u_vgt_pct"))
    others = [name for name in CHANNELS if name != channel]
    pair = pairs[rng.integers(2)] if rng.random() < 0.7 else (channel, others[rng.integers(len(others))])
    frame[list(pair)] = frame[list(pair)[::-1]].to_numpy()
    return frame, f"{pair[0]} with {pair[1]}"


def scale(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """A factor between 0.7 and 1.4."""
    factor = float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.02, 0.35)))
    frame[channel] *= factor
    return frame, f"x {factor:.3f}"


def offset(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """A shift by 2 to 20 % of the channel's mean."""
    share = rng.choice([-1, 1]) * rng.uniform(0.02, 0.2)
    frame[channel] += share * frame[channel].mean()
    return frame, f"{share:+.1%} of the mean"


def freeze(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """The last reading stays, for a tenth of the recording or up to the end."""
    since = int(rng.uniform(0.0, 0.8) * len(frame))
    count = int(rng.uniform(0.1, 1.0) * (len(frame) - since))
    frame.loc[since : since + count, channel] = float(frame.loc[since, channel])
    return frame, f"{count * STEP_S:.0f} s from {since * STEP_S:.0f} s"


def lag(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """A first-order lag of 0.5 to 5 s."""
    constant = float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    frame[channel] = frame[channel].ewm(alpha=1.0 - np.exp(-STEP_S / constant), adjust=False).mean()
    return frame, f"{constant:.2g} s"


def replay(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """A stretch is an earlier one once more."""
    count = int(rng.uniform(20.0, 120.0) / STEP_S)
    first = int(rng.integers(0, len(frame) - 2 * count))
    second = int(rng.integers(first + count, len(frame) - count))
    frame.loc[second : second + count - 1, channel] = frame.loc[first : first + count - 1, channel].to_numpy()
    return frame, f"{count * STEP_S:.0f} s"


def clip(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """Readings end at a quantile of theirs."""
    level = rng.uniform(0.5, 0.95)
    limit = float(frame[channel].quantile(level))
    frame[channel] = frame[channel].clip(upper=limit)
    return frame, f"above the {level:.0%} quantile"


def shift(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """A channel is early or late by 0.4 to 4 s."""
    delay = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.4), np.log(4.0))))
    time = frame["time_s"]
    frame[channel] = np.interp(time - delay, time, frame[channel])
    return frame, f"{delay:+.2g} s"


def time_base(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """A clock that is too fast or too slow by 3 to 30 %."""
    factor = float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.03, 0.3)))
    frame["time_s"] *= factor
    return frame, f"x {factor:.3f}"


def gaps(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """Holes of 3 to 30 s; half of the cases close them up."""
    closed = rng.random() < 0.5
    count = int(rng.integers(1, 6))
    kept = np.ones(len(frame), dtype=bool)
    for _ in range(count):
        first = int(rng.integers(0, len(frame) - 160))
        kept[first : first + int(rng.uniform(3.0, 30.0) / STEP_S)] = False
    frame = frame.loc[kept].copy()
    if closed:
        frame["time_s"] = STEP_S * np.arange(len(frame))
    return frame, f"{count} holes{', closed up' if closed else ''}"


def spikes(frame: pd.DataFrame, channel: str, rng: np.random.Generator) -> Mutilated:
    """Single readings far off."""
    count = int(np.exp(rng.uniform(0.0, np.log(60.0))))
    rows = rng.choice(len(frame), count, replace=False)
    size = float(rng.uniform(0.5, 5.0))
    frame.loc[rows, channel] *= 1.0 + rng.choice([-0.2, 1.0], count) * size
    return frame, f"{count} readings by up to {size:.2g}"


MUTILATIONS: dict[str, Mutilation] = {
    "drop": drop, "swap": swap, "scale": scale, "offset": offset, "freeze": freeze, "lag": lag, "replay": replay,
    "clip": clip, "shift": shift, "time_base": time_base, "gaps": gaps, "spikes": spikes,
}  # fmt: skip


def judged(
    number: int, frame: pd.DataFrame, truth: np.ndarray, case: tuple[str, str, str], runs: int | None = 1
) -> Verdict:
    """Identify with so many starts (None: the settings') and compare; `case` is kind, channel and severity."""
    began = time.perf_counter()
    end, text, codes = "answer", "", ()
    errors = sigmas = tuple(0.0 for _ in HEALTH)
    try:
        found = dt.identify(frame, "we2011", runs=runs)
        pooled = found.found.pooled()
        both = [(p.mean / true - 1.0, (p.mean - true) / p.std) if p.mean is not None and p.std else (0.0, 0.0)
                for p, true in ((pooled[name], true) for name, true in zip(HEALTH, truth, strict=True))]
        errors, sigmas = tuple(float(e) for e, _ in both), tuple(float(s) for _, s in both)
        codes = tuple(sorted({warning["code"] for warning in found.warnings}))
        text = found.warnings[0]["text"] if found.warnings else ""
    except InputError as error:
        end, text = "refused", str(error)
    except Exception:  # what is looked for
        end, text = "crash", traceback.format_exc()
    return Verdict(number, *case, end, codes, errors, sigmas, time.perf_counter() - began, text)


def verdicts(
    seed: int, cases: int, first: int = 0, only: str | None = None, runs: int | None = 1
) -> Iterator[Verdict]:
    """Mutilated recordings, each kind in turn, or clean ones where `only` is "clean"."""
    kinds = list(MUTILATIONS) if only in (None, "clean") else [only]
    for number, frame, truth in clean_recordings(seed, first):
        if number >= first + cases:
            return
        if number < first:
            continue
        if only == "clean":
            yield judged(number, frame, truth, ("clean", "", ""), runs)
            continue
        kind = kinds[number % len(kinds)]
        rng = np.random.default_rng([seed, number, 1])
        channel = CHANNELS[int(rng.integers(len(CHANNELS)))]
        frame, severity = MUTILATIONS[kind](frame, channel, rng)
        yield judged(number, frame.reset_index(drop=True), truth, (kind, channel, severity), runs)


def summary(found: list[Verdict]) -> list[str]:
    """Counts by kind."""
    lines = [f"{'kind':<10} {'cases':>5} {'crash':>5} {'refused':>7} {'warned':>6} {'wrong':>5} {'silent':>6}"]
    kinds = list(dict.fromkeys(item.kind for item in found))
    for kind in [*kinds, "all"]:
        some = [item for item in found if kind in (item.kind, "all")]
        ends = Counter(item.end for item in some)
        lines.append(f"{kind:<10} {len(some):>5} {ends['crash']:>5} {ends['refused']:>7} "
                     f"{sum(bool(item.codes) for item in some):>6} {sum(item.wrong for item in some):>5} "
                     f"{sum(item.silent for item in some):>6}")  # fmt: skip
    seconds = [item.seconds for item in found]
    return [*lines, f"median {np.median(seconds):.2f} s, longest {max(seconds):.1f} s"]


def main() -> None:
    """Run, print, and write one line of JSON a case where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first, to go on with a seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=[*MUTILATIONS, "clean"], help="one kind, or clean recordings")
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so much time")
    parser.add_argument("--out", type=Path, help="file of JSON lines to append to")
    parser.add_argument("--runs", type=int, default=1, help="starts a segment; 0: the settings'")
    arguments = parser.parse_args()
    began, found = time.perf_counter(), []
    for item in verdicts(arguments.seed, arguments.cases, arguments.first, arguments.only, arguments.runs or None):
        found.append(item)
        if arguments.out is not None:
            keep(arguments.out, {**asdict(item), "wrong": item.wrong, "silent": item.silent})
        if item.silent or item.end == "crash" or (item.kind == "clean" and item.codes):
            worst = max(range(len(HEALTH)), key=lambda i: abs(item.errors[i]))
            about = f"{item.seed} {item.kind} {item.channel} {item.severity}: {item.end} {item.codes}"
            told = f"{HEALTH[worst]} {item.errors[worst]:+.1%} ({item.sigmas[worst]:.1f} sd) {item.text[-600:]}"
            print(about, told, flush=True)
        if time.perf_counter() - began > arguments.seconds:
            break
    print("\n".join(summary(found)))


if __name__ == "__main__":
    main()
