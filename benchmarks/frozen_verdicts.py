"""Verdicts of discovery on sixty frozen benchmark cases, to be compared line by line before and after a change.

    python benchmarks/frozen_verdicts.py run FOLDER [--jobs 2]     # make the cases, run discovery; goes on if killed
    python benchmarks/frozen_verdicts.py table FOLDER NEW.jsonl    # one line a case, with the truth beside it
    python benchmarks/frozen_verdicts.py compare benchmarks/frozen_verdicts.jsonl NEW.jsonl

The cases are the main tier of `dieseltwin challenge make`, 40 with six sensors and 20 with five, ten minutes each, from
fixed seeds. They are no proof, because their seeds are open: they show what a change of the program changes. The
program under test is the one that Python finds (`PYTHONPATH` chooses another checkout). One core needs ten minutes.

`compare` prints every case whose verdict differs and ends with counts. The name sets, the site, a found law's form and
whether there is a mismatch must agree exactly, an onset within 2 s, magnitudes and health parameters within `--within`
standard deviations of the old verdict.
A verdict is better or worse by what it says of the truth: found, site, true names in the sets, no wrong set, true name
first; then by smaller sets; then by the distance of the magnitudes from the truth. Exit code 0 says that no case is
worse, 1 that one is or was not run, 2 that a file can't be used.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dieseltwin.atomic import write_text
from dieseltwin.errors import InputError

PARTS = {"six": (40, 6013, 6), "five": (20, 6014, 5)}
"""Folder -> number of cases, seed, number of sensors; the seeds differ so that the machines do."""

WITHIN_STD = 0.25  # what refits from another starting point move a magnitude by; verdicts that agree agree to 1e-3
WITHIN_S = 2.0  # what the search's own steps leave open in an onset
NONE_OF_THESE = "none_of_these"
NUMBER = re.compile(r"(?<![\w.^])(?<!\^-)[-+]?\d[\d.]*(?:e[-+]?\d+)?")  # neither an exponent nor the digits of a name
_DIGITS = 8


@dataclass(frozen=True)
class Effect:
    """One effect, true or reported: name, magnitude and standard deviation [unit of the effect], names that are not
    told from it, law, site and ratio to the tolerance of interest (true effects only)."""

    name: str
    magnitude: float | None = None
    std: float | None = None
    equivalent_names: tuple[str, ...] = ()
    law: str | None = None
    site: str | None = None
    ratio: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The reported set, its first name first."""
        return (self.name, *sorted(self.equivalent_names))


@dataclass(frozen=True)
class Verdict:
    """What was said of one case, and what was true.

    Attributes:
        case: part and name, such as six/case_0007.
        recording_sha256: of the recording; other recordings have other verdicts.
        kind: of the benchmark's mix ("healthy", "single", "two", "partial", "withheld").
        truth: the machine's effects; health_true: its health parameters.
        problem: why there is no verdict, else None.
        mismatch, p_value, site, onset_s, effects: of the document; gain: of the best single effect [-2 log likelihood].
        health: name -> (value, standard deviation).
        nll_before, nll_after: held-out negative log-likelihood per sample.
        seconds: of the run.
    """

    case: str
    recording_sha256: str
    kind: str
    truth: tuple[Effect, ...]
    health_true: Mapping[str, float]
    problem: str | None = None
    mismatch: bool = False
    p_value: float | None = None
    gain: float | None = None
    site: str | None = None
    onset_s: float | None = None
    effects: tuple[Effect, ...] = ()
    health: Mapping[str, tuple[float, float | None]] | None = None
    nll_before: float | None = None
    nll_after: float | None = None
    seconds: float | None = None

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Verdict:
        """From one line of a table."""
        values = dict(row)
        for key in ("truth", "effects"):
            values[key] = tuple(
                Effect(**{**effect, "equivalent_names": tuple(effect.get("equivalent_names", ()))})
                for effect in values.get(key, ())
            )
        return cls(**values)

    @property
    def said(self) -> tuple[tuple[str, ...], ...]:
        """The reported sets, in any order."""
        return tuple(sorted(effect.names for effect in self.effects))

    @property
    def law_form(self) -> str | None:
        """The law that stands where no name fits, its numbers left out but for exponents."""
        laws = [effect.law for effect in self.effects if effect.name == NONE_OF_THESE and effect.law]
        return NUMBER.sub("#", laws[0]) if laws else None

    def marks(self) -> tuple[int, int]:
        """How right the verdict is: number of marks, then minus the number of names said; the larger the better."""
        if self.problem is not None:
            return -1, 0
        if not self.truth:
            return int(not self.mismatch), 0
        true = {NONE_OF_THESE} if self.kind == "withheld" else {effect.name for effect in self.truth}
        named = {name for effect in self.effects for name in effect.names}
        count = int(self.mismatch) + int(self.site in {effect.site for effect in self.truth}) + len(true & named)
        count += all(true & set(effect.names) for effect in self.effects)
        count += bool(self.effects) and self.effects[0].name in true
        return count, -sum(len(effect.names) for effect in self.effects)

    def distance(self) -> float:
        """Summed relative errors of the magnitudes of true effects that are named first in their sets."""
        said = {effect.name: effect.magnitude for effect in self.effects}
        return sum(
            abs(size / effect.magnitude - 1.0)
            for effect in self.truth
            if effect.magnitude and (size := said.get(effect.name)) is not None
        )


@dataclass(frozen=True)
class Difference:
    """How a new verdict differs from the old one: `kind` ("same", "better", "worse" or "other") and in what."""

    case: str
    kind: str
    lines: tuple[str, ...]


def run(folder: Path, jobs: int) -> None:
    """Make the cases that are not there, run discovery on those without a verdict.

    Args:
        folder: for the recordings, the answers and the results, about 70 MB.
        jobs: number of processes.
    """
    for part, (n, seed, sensors) in PARTS.items():
        if not (folder / part / "manifest.json").is_file():
            made = ["make", "--n", n, "--seed", seed, "--sensors", sensors, "--out", folder / part, "--jobs", jobs]
            _challenge(*made)
    for part in PARTS:
        _challenge("run", folder / part, "--jobs", jobs)


def _challenge(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "dieseltwin", "challenge", *map(str, arguments)], check=True)


def verdicts(folder: Path) -> Iterator[Verdict]:
    """Verdicts of all cases that were run, with the sealed truth.

    Raises:
        InputError: no cases in the folder.
    """
    for part in PARTS:
        manifest = folder / part / "manifest.json"
        if not manifest.is_file():
            raise InputError(str(manifest), "no such file", "a folder of `frozen_verdicts.py run`", "run it first")
        for entry in _json(manifest)["cases"]:
            result = folder / part / "results" / entry["case"]
            if result.is_dir():
                answers = _json(folder / part / "sealed" / f"{entry['case']}.json")
                yield _verdict(f"{part}/{entry['case']}", entry["recording_sha256"], answers, result)


def _verdict(case: str, sha256: str, answers: Mapping[str, Any], result: Path) -> Verdict:
    truth = tuple(
        Effect(name=e["effect"], magnitude=e["magnitude"], site=e["site"], ratio=e["ratio"]) for e in answers["effects"]
    )
    known: dict[str, Any] = {"case": case, "recording_sha256": sha256, "kind": answers["kind"], "truth": truth,
                             "health_true": answers["health"]}  # fmt: skip
    if not (result / "discrepancy.json").is_file():
        failed = _json(result / "failed.json")
        return Verdict(**known, problem=f"{failed['error']} ({failed['where']})", seconds=failed["seconds"])
    document, details = _json(result / "discrepancy.json"), _json(result / "details.json")
    location = document["location"] or {}
    keys = ("name", "magnitude", "std", "equivalent_names", "law")
    return Verdict(
        **known, mismatch=document["mismatch"], p_value=document["p_value"],
        gain=details["singles"][0]["gain"] if details["singles"] else None,
        site=location.get("site"), onset_s=location.get("onset_s"),
        effects=tuple(Effect(**{key: effect[key] for key in keys}) for effect in document["effects"]),
        health={name: (value["value"], value["std"]) for name, value in document["health"].items()},
        nll_before=document["fit"]["held_out_nll_before"], nll_after=document["fit"]["held_out_nll_after"],
        seconds=_json(result / "runtime.json")["seconds"],
    )  # fmt: skip


def _json(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _short(value: Any) -> Any:
    """Nested numbers to eight digits, without what is empty: a table is small, and its lines can be read."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _short(item) for key, item in value.items() if item is not None and item != ()}
    return [_short(item) for item in value] if isinstance(value, list | tuple) else value


def write_table(folder: Path, path: Path) -> int:
    """Write the verdicts of a folder as JSON lines; returns their number."""
    lines = [json.dumps(_short(asdict(verdict)), allow_nan=False) for verdict in verdicts(folder)]
    write_text(path, "".join(f"{line}\n" for line in lines))
    return len(lines)


def read_table(path: Path) -> dict[str, Verdict]:
    """Verdicts by case.

    Raises:
        InputError: no such file, or not a table of `frozen_verdicts.py table`.
    """
    try:
        rows = [Verdict.of(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(str(path), error, "a table of `frozen_verdicts.py table`", "write it again") from None
    return {row.case: row for row in rows}


def difference(old: Verdict, new: Verdict, within: float) -> Difference:
    """Compare two verdicts of one case.

    Args:
        old, new: of the same case.
        within: standard deviations of the old verdict by which magnitudes and health parameters may move.
    """
    lines = []
    if old.problem != new.problem:
        lines.append(f"problem: {old.problem or 'none'} -> {new.problem or 'none'}")
    if old.mismatch != new.mismatch:
        lines.append(f"mismatch: {old.mismatch} -> {new.mismatch}")
    if old.site != new.site:
        lines.append(f"site: {old.site} -> {new.site}")
    if old.said != new.said:
        lines.append(f"names: {_words(old)} -> {_words(new)}")
    named = not lines
    if old.law_form != new.law_form:
        lines.append(f"law: {old.law_form} -> {new.law_form}")
    if abs((new.onset_s or 0.0) - (old.onset_s or 0.0)) > WITHIN_S:
        lines.append(f"onset: {old.onset_s} s -> {new.onset_s} s")
    closer = new.distance() - old.distance()
    moved = list(_moved(old, new, within))
    lines += moved
    better = (new.marks() > old.marks()) - (new.marks() < old.marks())
    if named and any(line.startswith("magnitude") for line in moved):
        better = (closer < 0.0) - (closer > 0.0)
    kind = "same" if not lines else {1: "better", -1: "worse", 0: "other"}[better]
    return Difference(old.case, kind, tuple(lines))


def _words(verdict: Verdict) -> str:
    return " + ".join("|".join(names) for names in verdict.said) or "healthy"


def _truth_words(verdict: Verdict) -> str:
    said = (f"{e.name} {e.magnitude:.4g} ({e.ratio:.2g} x tolerance) at {e.site}" for e in verdict.truth)
    return " + ".join(said) or "no effect"


def _moved(old: Verdict, new: Verdict, within: float) -> Iterator[str]:
    before = {f"magnitude of {e.name}": (e.magnitude, e.std) for e in old.effects}
    after = {f"magnitude of {e.name}": e.magnitude for e in new.effects}
    before |= {f"health {name}": value for name, value in (old.health or {}).items()}
    after |= {f"health {name}": value[0] for name, value in (new.health or {}).items()}
    for name, (value, std) in before.items():
        now = after.get(name)
        if value is None or now is None:
            continue
        steps = abs(now - value) / std if std else (0.0 if now == value else float("inf"))
        if steps > within:
            yield f"{name}: {value:.5g} -> {now:.5g} ({steps:.2g} standard deviations)"


def compare(old: Mapping[str, Verdict], new: Mapping[str, Verdict], within: float) -> tuple[list[str], int]:
    """What differs between two tables, as lines to print, and the exit code."""
    out: list[str] = []
    counts = {"same": 0, "better": 0, "worse": 0, "other": 0, "not run": 0}
    recordings = 0
    for case, before in old.items():
        after = new.get(case)
        if after is None:
            counts["not run"] += 1
            continue
        recordings += before.recording_sha256 != after.recording_sha256
        found = difference(before, after, within)
        counts[found.kind] += 1
        if found.kind != "same":
            out.append(f"{case} {found.kind}; true ({before.kind}): {_truth_words(before)}")
            out += [f"    {line}" for line in found.lines]
    if recordings:
        out.append(f"{recordings} cases have other recordings than in the old table: the benchmark itself has changed")
    seconds = [[table[case].seconds or 0.0 for case in old if case in new] for table in (old, new)]
    out.append(f"seconds of the cases in both: {sum(seconds[0]):.0f} -> {sum(seconds[1]):.0f}")
    out.append(", ".join(f"{count} {name}" for name, count in counts.items() if count or name in ("same", "worse")))
    return out, int(bool(counts["worse"] or counts["not run"]))


def main(arguments: list[str] | None = None) -> int:
    """Run the program; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="make the cases and run discovery on them")
    running.add_argument("folder", type=Path)
    running.add_argument("--jobs", type=int, default=1)
    table = commands.add_parser("table", help="write the verdicts of a folder, one line a case")
    table.add_argument("folder", type=Path)
    table.add_argument("out", type=Path)
    comparing = commands.add_parser("compare", help="compare two tables")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--within", type=float, default=WITHIN_STD, help="standard deviations of the old verdict")
    given = parser.parse_args(arguments)
    try:
        if given.command == "run":
            run(given.folder, given.jobs)
        elif given.command == "table":
            print(f"{given.out}: {write_table(given.folder, given.out)} cases")
        else:
            lines, code = compare(read_table(given.old), read_table(given.new), given.within)
            print("\n".join(lines))
            return code
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
