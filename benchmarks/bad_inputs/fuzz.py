"""A grammar-based fuzzer: files made of pieces that readers know, put together wrongly, given to every command.

    python -m benchmarks.bad_inputs.fuzz --minutes 10 --seed 1

A case is a table, a document of YAML, bytes of a foreign format or a damaged good file, and a command that reads it.
Whatever comes, a command has to end in an answer or in one line of at most 300 characters with exit code 2, without a
traceback and without a partial file.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Container
from contextlib import suppress
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

from benchmarks.bad_inputs.case import Case
from benchmarks.bad_inputs.cases import INPUTS, SENSORS, good_files
from benchmarks.bad_inputs.run import Outcome, run_case


class BadEnd(Exception):
    """A case that ended in neither an answer nor a proper refusal: command, ending of the file, content, outcome."""

    def __init__(self, command: str, ending: str, content: Content, outcome: Outcome) -> None:
        super().__init__(command, ending, content, outcome)
        self.kind = outcome.traceback or f"{command}: {', '.join(outcome.faults)}"


class TimeIsUp(KeyboardInterrupt):
    """Ends Hypothesis, which goes on drawing cases after anything less."""


SHORT = {"drive.csv": 100, "points.csv": 15}
"""Rows of the files that are damaged: too few for anything to be computed from what happens to stay whole."""

SLOW_S = 20.0  # longer than any refusal
Content = str | bytes

NAMES = st.sampled_from(
    [*INPUTS, *SENSORS, "w_c_kg_s", "p_amb_pa", "t_amb_k", "t_im_k", "u_flap_pct", "Time [s]", "", "a" * 300, "\u202e"]
)
NUMBERS = st.one_of(
    st.floats(), st.integers(-(10**20), 10**20), st.sampled_from([0, 1, -1, 300, 1e5, 1e300, 1e-300, 2**63]))
CELLS = st.one_of(NUMBERS.map(str), st.sampled_from(["", "nan", "1,5", "0x1f", "TRUE", "12:00", "--", '"', "1e999"]))
KEYS = st.sampled_from([
    "V_d", "n_cyl", "J_t", "c_vol", "terms", "effect", "magnitude", "onset_s", "region", "n_e_range", "kind", "learned",
    "learned_sha256", "t", "column", "unit", "scale", "offset", "via", "dbc", "identify", "methods", "profiles", "seed",
    "bore_mm", "displacement_l", "time_s", "p_im_pa", "sha256",
])  # fmt: skip
WORDS = st.sampled_from(["we2011", "kPa", "boost_leak", "time_s", "mine.learned.parquet", "../x", "liu_petrol", ""])
VALUES = st.recursive(
    st.one_of(NUMBERS, st.booleans(), st.none(), WORDS),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(KEYS, inner, max_size=4)), max_leaves=12)
ENDINGS = st.sampled_from([".csv", ".txt", ".parquet", ".xlsx", ".mat", ".mf4", ".mdf", ".asc", ".blf", ".log", ".dbc",
                           ".h5", "", ".CSV", ".yaml"])  # fmt: skip
MAGIC = st.sampled_from([b"", b"PAR1", b"MDF     4.10", b"PK\x03\x04", b"MATLAB 5.0 MAT-file", b"\x89HDF\r\n\x1a\n",
                         b"date Mon\nbase hex\n", b"(0.0) can0 18FEF100#0102\n", b"\xff\xfe", b"LOGG"])  # fmt: skip


@st.composite
def tables(draw: st.DrawFn) -> str:
    """A table of known columns with a few strange cells, names or rows."""
    separator = draw(st.sampled_from([",", ";", "\t", " "]))
    names = draw(st.lists(NAMES, min_size=1, max_size=12))
    if draw(st.booleans()):
        names = [*INPUTS, *SENSORS]
    rows = draw(st.integers(0, 40))
    usual = {"time_s": 0.2, "n_e_rpm": 1.0, "u_delta_mg": 0.5}
    cells = [[f"{usual.get(name, 0.1) * row + 1:g}" for name in names] for row in range(rows)]
    for _ in range(draw(st.integers(0, 5))):
        if rows and names:
            at = cells[draw(st.integers(0, rows - 1))]
            at[draw(st.integers(0, len(at) - 1))] = draw(CELLS)
    if rows and draw(st.integers(0, 4)) == 0:
        cells[draw(st.integers(0, rows - 1))].append("1")
    return "\n".join(separator.join(line) for line in [names, *cells])


@st.composite
def documents(draw: st.DrawFn) -> str:
    """YAML of known keys with values of other kinds, now and then broken off or with something odd in it."""
    import yaml

    text = yaml.safe_dump(draw(st.dictionaries(KEYS, VALUES, max_size=5)), allow_unicode=True)
    if draw(st.booleans()):
        at = draw(st.integers(0, len(text)))
        odd = draw(st.sampled_from(["&a ", "*a", "!!python/object:os.system ", "\t", "{", "]", "- ", ": ", "\x00"]))
        text = text[:at] + odd + text[at:]
    return text


@st.composite
def damaged(draw: st.DrawFn, folder: Path) -> bytes:
    """A good file with bytes changed, cut out, doubled or cut off."""
    names = ("drive.csv", "points.csv", "engine.yaml", "map.yaml", "drive.parquet", "drive.xlsx")
    content = bytearray((folder / draw(st.sampled_from([n for n in names if (folder / n).exists()]))).read_bytes())
    for _ in range(draw(st.integers(1, 4))):
        at, count = draw(st.integers(0, len(content))), draw(st.integers(1, 400))
        how = draw(st.sampled_from(["change", "cut", "double", "end"]))
        if how == "change":
            content[at : at + 1] = bytes([draw(st.integers(0, 255))])
        elif how == "cut":
            del content[at : at + count]
        elif how == "double":
            content[at:at] = content[at : at + count]
        else:
            del content[at:]
    return bytes(content)


COMMANDS: dict[str, Callable[[str, str], list[str]]] = {
    "simulate": lambda p, f: ["simulate", p, "--out", f"{f}/o.csv"],
    "identify": lambda p, f: ["identify", p, "--out", f"{f}/o", "--runs", "1"],
    "discover": lambda p, f: ["discover", p, "--out", f"{f}/o"],
    "learn": lambda p, f: ["learn", p, "--out", f"{f}/o.yaml"],
    "calibrate": lambda p, f: ["calibrate", p, "--out", f"{f}/o.yaml"],
    "imply": lambda p, f: ["imply", f"{f}/points.csv", "--engine", p, "--out", f"{f}/o.csv"],
    "channels": lambda p, f: ["channels", p, "--out", f"{f}/o.yaml"],
    "as engine": lambda p, f: ["engine", "show", "--engine", p],
    "as base": lambda p, f: ["calibrate", f"{f}/points.csv", "--base", p, "--out", f"{f}/o.yaml"],
    "as map": lambda p, f: ["simulate", f"{f}/drive.csv", "--channels", p, "--out", f"{f}/o.csv"],
    "as params": lambda p, _: ["params", "show", "--params", p],
    "as geometry": lambda p, f: ["calibrate", f"{f}/points.csv", "--geometry", p, "--out", f"{f}/o.yaml"],
    "as petrol recording": lambda p, f: ["calibrate", p, "--base", "liu_petrol", "--out", f"{f}/o.yaml"],
    "explain": lambda p, f: ["discover", "--explain", "boost_leak", "--out", p],
}  # fmt: skip


def contents(folder: Path) -> st.SearchStrategy[Content]:
    """Everything that a file may hold."""
    binary = st.tuples(MAGIC, st.binary(max_size=300)).map(b"".join)
    return st.one_of(tables(), documents(), damaged(folder), binary)


def fault_of(outcome: Outcome) -> tuple[str, ...]:
    """What is wrong with how a command ended; an answer is no fault here, since a file may happen to be good."""
    faults = [fault for fault in outcome.faults if fault not in ("exit code 0", "exit code 3")]
    return (*faults, "too slow") if outcome.code == 2 and outcome.seconds > SLOW_S else tuple(faults)


def check(content: Content, ending: str, command: str, folder: Path) -> Outcome:
    """Write the content into a new folder, run the command, and say how it ended."""

    def make(place: Path) -> list[str]:
        path = place / f"bad{ending}"
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
        return COMMANDS[command](str(path), str(place))

    place = Path(tempfile.mkdtemp(dir=folder))
    try:
        return run_case(Case(command, make), place)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def fuzz(
    seconds: float, seed: int, commands: tuple[str, ...] = tuple(COMMANDS), most: int = 10**6,
    known: Container[str] = (), counts: Counter[str] | None = None,
) -> Counter[str]:  # fmt: skip
    """Fuzz until the time is up; counts of how cases ended.

    `known`: bad ends that were found before and stop it no more, as `BadEnd.kind` names them; `counts`: to go on with.

    Raises:
        BadEnd: a case that is no proper end, the smallest that was found.
    """
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    good_files(folder)
    for name, rows in SHORT.items():
        (folder / name).write_text("\n".join((folder / name).read_text().splitlines()[: rows + 1]) + "\n")
    seen = Counter() if counts is None else counts
    until = time.monotonic() + seconds

    @seeded(seed)
    @settings(max_examples=most, deadline=None, database=None, derandomize=False, phases=(Phase.generate, Phase.shrink),
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(contents(folder), ENDINGS, st.sampled_from(commands))
    def one(content: Content, ending: str, command: str) -> None:
        if time.monotonic() > until:
            raise TimeIsUp
        outcome = check(content, ending, command, folder)
        seen[f"{command}: exit {outcome.code}"] += 1
        if fault_of(outcome) and (met := BadEnd(command, ending, content[:500], outcome)).kind not in known:
            raise met

    try:
        with suppress(TimeIsUp):
            one()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return seen


def main() -> None:
    """Fuzz for some minutes and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", type=int, default=20_000, help="at most")
    arguments = parser.parse_args()
    found: Counter[str] = Counter()
    bad: dict[str, BadEnd] = {}
    until, seed = time.monotonic() + 60.0 * arguments.minutes, arguments.seed
    while (left := until - time.monotonic()) > 0 and found.total() < arguments.cases:
        try:
            fuzz(left, seed, most=arguments.cases - found.total(), known=bad, counts=found)
        except BadEnd as met:
            bad[met.kind] = met
            print(met, flush=True)
        seed += 1
    for name in sorted(found):
        print(f"{found[name]:>6}  {name}")
    print(f"{found.total():>6}  in all, {len(bad)} kinds of bad ends")
    if bad:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
