"""Every line of the table of docs/benchmark.md, counted from `CaseRow`s. Definitions stand with each function.

Counted cases are those whose largest fault is at least three tolerances. A case without a result counts against the
tool among alarms, detection, sites, names and "none of these" of withheld effects. What is measured on an answer leaves
it out: sizes of sets, laws, magnitudes and their coverage, health, gain and time; and it has said no false "none".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from dieseltwin.challenge.records import COUNTED_RATIO, CaseRow, TrueEffect
from dieseltwin.engine import HEALTH

COVERAGE_Z = 1.6448536269514722  # 90 % of a Gaussian
LEAST_GAIN = 10.0  # log-likelihood units on the second recording below which a share of the gain is noise
LAW_WITHIN = 0.10


@dataclass(frozen=True)
class Share:
    """A count with its Clopper-Pearson interval (95 %)."""

    hits: int
    of: int

    @property
    def value(self) -> float | None:
        """Share, None without cases."""
        return self.hits / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Exact 95 % interval."""
        if not self.of:
            return 0.0, 1.0
        low = 0.0 if self.hits == 0 else float(beta.ppf(0.025, self.hits, self.of - self.hits + 1))
        high = 1.0 if self.hits == self.of else float(beta.ppf(0.975, self.hits + 1, self.of - self.hits))
        return low, high

    def __str__(self) -> str:
        if not self.of:
            return "no cases"
        low, high = self.interval
        return f"{100 * self.hits / self.of:.1f} % ({self.hits}/{self.of}; {100 * low:.1f}-{100 * high:.1f} %)"


def healthy(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """Machines without a fault."""
    return [row for row in rows if row.kind == "healthy"]


def counted(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """Machines with a fault of at least three tolerances."""
    return [row for row in rows if row.ratio >= COUNTED_RATIO]


def nameable(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """Faulty machines whose faults the tool could name."""
    return [row for row in rows if row.truth and not row.withheld]


def false_alarms(rows: Sequence[CaseRow]) -> Share:
    """Healthy recordings with `mismatch`. One without a result is counted as an alarm."""
    cases = healthy(rows)
    return Share(sum(row.mismatch or row.problem is not None for row in cases), len(cases))


def detection(rows: Sequence[CaseRow]) -> Share:
    """Counted cases with `mismatch`, withheld, partial and double ones included."""
    cases = counted(rows)
    return Share(sum(row.mismatch for row in cases), len(cases))


def sites(rows: Sequence[CaseRow]) -> Share:
    """Counted cases whose first site is that of the fault (of one of two faults), undetected ones being wrong."""
    cases = counted(rows)
    return Share(sum(row.site in {effect.site for effect in row.truth} for row in cases), len(cases))


def name_units(rows: Sequence[CaseRow]) -> list[tuple[CaseRow, TrueEffect]]:
    """Faults that names are counted over: at least three tolerances, not withheld; two in a case are two."""
    return [(row, e) for row in nameable(rows) for e in row.truth if e.ratio >= COUNTED_RATIO]


def names_in_set(rows: Sequence[CaseRow]) -> Share:
    """Faults whose name stands in a reported set (name or equivalent names of any reported effect)."""
    units = name_units(rows)
    return Share(sum(effect.name in row.named for row, effect in units), len(units))


def mean_set_size(rows: Sequence[CaseRow]) -> float | None:
    """Mean size of the reported sets in cases with a nameable counted fault; `none_of_these` is no set."""
    cases = {row.case: row for row, _ in name_units(rows)}.values()
    sizes = [len(e.names) for row in cases for e in row.said if e.names != ("none_of_these",)]
    return float(np.mean(sizes)) if sizes else None


def top_names(rows: Sequence[CaseRow], any_size: bool = False) -> Share:
    """Of counted single faults (partial ones included; `any_size`: smaller ones too) that are separable at the truth,
    those whose name is reported first."""
    cases = nameable(rows) if any_size else counted(nameable(rows))
    return _named_first(row for row in cases if len(row.truth) == 1 and row.truth[0].separable)


def top_names_unconditioned(rows: Sequence[CaseRow]) -> Share:
    """Counted single faults whose name is reported first, separable or not."""
    return _named_first(row for row in counted(nameable(rows)) if len(row.truth) == 1)


def _named_first(singles: Iterable[CaseRow]) -> Share:
    right = [bool(row.said) and row.said[0].name == row.truth[0].name for row in singles]
    return Share(sum(right), len(right))


def withheld_none(rows: Sequence[CaseRow], separable_only: bool = False) -> Share:
    """Counted withheld cases with `none_of_these` first; `separable_only`: those that no other name imitates."""
    cases = [row for row in counted(rows) if row.withheld]
    if separable_only:
        cases = [row for row in cases if row.truth[0].separable]
    return Share(sum(row.said_none for row in cases), len(cases))


def false_none(rows: Sequence[CaseRow]) -> Share:
    """Faulty cases whose names the tool knew and `none_of_these` is reported all the same (at any place)."""
    cases = nameable(rows)
    return Share(sum("none_of_these" in row.named for row in cases), len(cases))


def law_cases(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """Counted withheld cases answered by `none_of_these`: those whose law is judged."""
    return [row for row in counted(rows) if row.withheld and row.said_none]


def laws(rows: Sequence[CaseRow], right_hand_side: bool = False) -> Share:
    """Counted withheld cases answered by `none_of_these` whose law is within 10 % on unseen driving (no law: not).

    `right_hand_side`: those only whose fault is a flow, power or temperature, not a sensor or an actuator.
    """
    cases = law_cases(rows)
    if right_hand_side:
        cases = [row for row in cases if not row.truth[0].site.startswith("sensor:")]
        cases = [row for row in cases if not row.truth[0].site.endswith("_actuator")]
    return Share(sum(row.law_error is not None and row.law_error <= LAW_WITHIN for row in cases), len(cases))


def oracle_laws(rows: Sequence[CaseRow]) -> Share:
    """Of the cases of `laws` with a catalogued effect, those where the true form with the oracle's magnitude is within
    10 % on unseen driving: what map and sensor tolerances of the recording allow a law that has the right form."""
    errors = [row.oracle_law_error for row in law_cases(rows) if row.oracle_law_error is not None]
    return Share(sum(error <= LAW_WITHIN for error in errors), len(errors))


def laws_where_oracle(rows: Sequence[CaseRow]) -> Share:
    """`laws` over those of its cases where the oracle's law is within 10 %, or is not known."""
    able = [r for r in law_cases(rows) if r.oracle_law_error is None or r.oracle_law_error <= LAW_WITHIN]
    return laws(able)


def magnitude_errors(rows: Sequence[CaseRow]) -> np.ndarray:
    """Relative errors of the magnitude where a counted fault's own name is reported, (k,)."""
    return np.array([abs(m - e.magnitude) / abs(e.magnitude) for _, e, m, _ in _sizes(rows)])


def coverage(rows: Sequence[CaseRow]) -> Share:
    """Of those: true magnitude inside the 90 % interval (1.645 standard deviations)."""
    with_std = [(e, m, s) for _, e, m, s in _sizes(rows) if s is not None]
    return Share(sum(abs(m - e.magnitude) <= COVERAGE_Z * s for e, m, s in with_std), len(with_std))


def _sizes(rows: Sequence[CaseRow]) -> list[tuple[CaseRow, TrueEffect, float, float | None]]:
    found = []
    for row, effect in name_units(rows):
        for one in row.said:
            if one.name == effect.name and one.magnitude is not None:
                found.append((row, effect, one.magnitude, one.std))
                break
    return found


@dataclass(frozen=True)
class HealthBias:
    """Median relative error of the health parameters over cases, before and after the repair [-].

    `oracle`: of a fit that is told the true form, over the same cases: what maps and sensors of this tolerance allow.
    """

    before: float
    after: float
    after_by_name: dict[str, float]
    before_by_name: dict[str, float]
    cases: int
    oracle: float | None = None

    @property
    def factor(self) -> float:
        """How many times smaller."""
        return self.before / max(self.after, 1e-12)


def health_bias(rows: Sequence[CaseRow]) -> HealthBias | None:
    """Over the counted cases whose names the tool knew and that have a result; medians over cases and parameters."""
    cases = [row for row in counted(nameable(rows)) if row.problem is None and row.health_after]
    if not cases:
        return None
    true, before, after = (
        np.array([[getattr(row, k)[name] for name in HEALTH] for row in cases])
        for k in ("health_true", "health_before", "health_after")
    )
    bias_before, bias_after = np.abs(before / true - 1.0), np.abs(after / true - 1.0)
    by_name = [dict(zip(HEALTH, np.median(b, axis=0).tolist(), strict=True)) for b in (bias_after, bias_before)]
    told = [row for row in cases if row.oracle_health]
    oracle = [abs(row.oracle_health[name] / row.health_true[name] - 1.0) for row in told for name in HEALTH]
    return HealthBias(
        float(np.median(bias_before)), float(np.median(bias_after)), by_name[0], by_name[1], len(cases),
        float(np.median(oracle)) if oracle else None,
    )  # fmt: skip


def since_errors(rows: Sequence[CaseRow]) -> dict[str, np.ndarray]:
    """Health parameter -> relative errors of what is said of its change since the reference [-]."""
    names = dict.fromkeys(name for row in rows for name in row.since_said)
    return {
        name: np.array([abs(r.since_said[name][0] / r.since_true[name] - 1.0) for r in rows if name in r.since_said])
        for name in names
    }


def since_coverage(rows: Sequence[CaseRow]) -> Share:
    """Changes since the reference inside their 90 % intervals."""
    inside = [
        abs(value - row.since_true[name]) <= COVERAGE_Z * std
        for row in rows for name, (value, std) in row.since_said.items()
    ]  # fmt: skip
    return Share(sum(inside), len(inside))


def gains(rows: Sequence[CaseRow]) -> tuple[np.ndarray, int]:
    """Share of the oracle's gain on the second recording over counted nameable cases, (k,), and how many were left out
    because the oracle itself gains less than 10 log-likelihood units there."""
    values, small = [], 0
    for row in counted(nameable(rows)):
        if row.nll_before is None or row.nll_after is None or row.nll_oracle is None:
            continue
        possible = row.nll_before - row.nll_oracle
        if possible * row.samples < LEAST_GAIN:
            small += 1
            continue
        values.append((row.nll_before - row.nll_after) / possible)
    return np.array(values), small


def times(rows: Sequence[CaseRow]) -> np.ndarray:
    """Seconds of every case that has a result, (k,)."""
    return np.array([row.seconds for row in rows if row.seconds is not None])


def _off(row: CaseRow) -> str:
    """How far a law is off, and how far the oracle's."""
    said = [] if row.law_error is None else [f"{100 * row.law_error:.0f} % off"]
    if row.oracle_law_error is not None:
        said.append(f"the oracle {100 * row.oracle_law_error:.0f} %")
    return "; ".join(said)


def failures(rows: Sequence[CaseRow]) -> list[dict[str, str | float]]:
    """Every failure, one row each: kind, case, what was true and what was said."""
    found: list[dict[str, str | float]] = []

    def add(row: CaseRow, failure: str, detail: str = "") -> None:
        found.append({
            "failure": failure, "case": row.case,
            "kind": row.kind if row.partial is None else f"{row.kind}: {row.partial}",
            "route": row.route, "ratio": round(row.ratio, 2),
            "true": " + ".join(e.name for e in row.truth) or "healthy",
            "said": " + ".join("|".join(e.names) for e in row.said) or "healthy", "site": row.site or "",
            "p_value": "" if row.p_value is None else row.p_value, "detail": detail,
        })  # fmt: skip

    for row in rows:
        if row.problem is not None:
            add(row, "no result", row.problem)
            continue
        if row.kind == "healthy":
            if row.mismatch:
                add(row, "false alarm")
            continue
        if row.ratio < COUNTED_RATIO:
            continue
        if not row.mismatch:
            add(row, "missed")
            continue
        if row.site not in {e.site for e in row.truth}:
            add(row, "wrong site", f"true {' + '.join(e.site for e in row.truth)}")
        if row.withheld:
            if not row.said_none:
                near = row.truth[0].nearest
                add(row, "withheld, named all the same", "" if near is None else f"D to {near[0]} {near[1]:.1f}")
            elif row.law_error is None or row.law_error > LAW_WITHIN:
                add(row, "no law within 10 %", _off(row))
            continue
        if "none_of_these" in row.named:
            add(row, "false none")
        for effect in row.truth:
            if effect.ratio >= COUNTED_RATIO and effect.name not in row.named:
                add(row, "name not in the set", effect.name)
        if len(row.truth) == 1 and row.truth[0].separable and row.said and row.said[0].name != row.truth[0].name:
            add(row, "separable, another name first", row.truth[0].name)
    for row, effect, magnitude, _ in _sizes(rows):
        if abs(magnitude / effect.magnitude - 1.0) > 0.3:
            add(row, "magnitude off by over 30 %", f"{effect.name}: {magnitude:.4g} for {effect.magnitude:.4g}")
    return found
