"""The table of docs/benchmark.md as numbers, verdicts and Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dieseltwin.challenge import metrics
from dieseltwin.challenge.metrics import Share
from dieseltwin.challenge.records import CaseRow, oracle_row
from dieseltwin.engine import HEALTH

MISSING = "not known"
_HEALTH, _HEALTH_AIM = "health-parameter bias, before -> after", "/ 10, <= 1 % (h_tot 3 %)"


@dataclass(frozen=True)
class Line:
    """One line: what, the value in words, both targets in words, whether each is reached (None: no value)."""

    key: str
    metric: str
    value: str
    pass_at: str
    aim: str
    passed: bool | None
    aimed: bool | None
    numbers: Mapping[str, Any]


def _share(key: str, metric: str, share: Share, pass_at: float, aim: float, smaller: bool = False) -> Line:
    sign = "<=" if smaller else ">="
    value = share.value

    def reached(target: float) -> bool | None:
        if value is None:
            return None
        return value <= target if smaller else value >= target

    numbers = {"hits": share.hits, "of": share.of, "value": value, "interval": list(share.interval)}
    return Line(key, metric, str(share), f"{sign} {100 * pass_at:g} %", f"{sign} {100 * aim:g} %", reached(pass_at),
                reached(aim), numbers)  # fmt: skip


def lines(rows: Sequence[CaseRow]) -> list[Line]:
    """Every line of the table; the definitions stand with the functions of `metrics`."""
    return [
        _share("false_alarms", "false alarms, healthy", metrics.false_alarms(rows), 0.02, 0.005, smaller=True),
        _share("detection", "detection at >= 3 x tolerance", metrics.detection(rows), 0.95, 0.99),
        _share("site", "site right", metrics.sites(rows), 0.85, 0.95),
        _share("name_in_set", "true name in the reported set", metrics.names_in_set(rows), 0.95, 0.98),
        _set_size(metrics.mean_set_size(rows)),
        _share("top_name", "first name right, separable (D >= 9)", metrics.top_names(rows), 0.85, 0.93),
        _share("withheld_none", "withheld -> none of these", metrics.withheld_none(rows), 0.70, 0.90),
        _share("false_none", "false none of these", metrics.false_none(rows), 0.03, 0.03, smaller=True),
        _law(metrics.laws(rows), metrics.oracle_laws(rows)),
        _magnitude(metrics.magnitude_errors(rows)),
        _coverage(metrics.coverage(rows)),
        _health(metrics.health_bias(rows)),
        _gain(*metrics.gains(rows)),
        _time(metrics.times(rows)),
        *_since(rows),
    ]


def _since(rows: Sequence[CaseRow]) -> list[Line]:
    """Health since the reference; no line where no case has one."""
    errors = metrics.since_errors(rows)
    if not errors:
        return []
    medians = {name: float(np.median(values)) for name, values in errors.items()}
    passed, aimed = (
        all(value <= (loose if name == "h_tot" else tight) for name, value in medians.items())
        for tight, loose in ((0.006, 0.02), (0.003, 0.01))
    )
    text = ", ".join(f"{name} {100 * value:.2f} %" for name, value in medians.items())
    share = metrics.since_coverage(rows)
    covered = share.value
    return [
        Line("since", "health since the reference, median error", text, "<= 0.6 %, h_tot 2 %", "<= 0.3 %, h_tot 1 %",
             passed, aimed, {"medians": medians, "of": len(rows)}),
        Line("since_coverage", "its 90 % intervals cover", str(share), "85-95 %", "88-92 %",
             None if covered is None else 0.85 <= covered <= 0.95, None if covered is None else 0.88 <= covered <= 0.92,
             {"hits": share.hits, "of": share.of, "value": covered}),
    ]  # fmt: skip


def _law(share: Share, oracle: Share) -> Line:
    line = _share("law", "its law within 10 % on unseen driving", share, 0.70, 0.70)
    if not oracle.of:
        return line
    value = f"{line.value}; the oracle's law {oracle.hits}/{oracle.of}"
    return replace(line, value=value, numbers={**line.numbers, "oracle_hits": oracle.hits, "oracle_of": oracle.of})


def _set_size(size: float | None) -> Line:
    if size is None:
        return Line("set_size", "mean size of the set", MISSING, "<= 2.5", "<= 1.7", None, None, {})
    return Line("set_size", "mean size of the set", f"{size:.2f}", "<= 2.5", "<= 1.7", size <= 2.5, size <= 1.7,
                {"value": size})  # fmt: skip


def _magnitude(errors: np.ndarray) -> Line:
    if not errors.size:
        return Line("magnitude", "magnitude error, median / p90", MISSING, "10 / 30 %", "4 / 12 %", None, None, {})
    half, p90 = np.quantile(errors, [0.5, 0.9])
    return Line(
        "magnitude", "magnitude error, median / p90", f"{100 * half:.1f} / {100 * p90:.1f} % ({errors.size})",
        "<= 10 / 30 %", "<= 4 / 12 %", bool(half <= 0.10 and p90 <= 0.30), bool(half <= 0.04 and p90 <= 0.12),
        {"median": float(half), "p90": float(p90), "of": int(errors.size)},
    )  # fmt: skip


def _coverage(share: Share) -> Line:
    value = share.value
    return Line("coverage", "coverage of 90 % intervals", str(share), "80-97 %", "87-93 %",
                None if value is None else 0.80 <= value <= 0.97, None if value is None else 0.87 <= value <= 0.93,
                {"hits": share.hits, "of": share.of, "value": value, "interval": list(share.interval)})  # fmt: skip


def _health(bias: metrics.HealthBias | None) -> Line:
    if bias is None:
        return Line("health", _HEALTH, MISSING, "/ 4", _HEALTH_AIM, None, None, {})
    after = ", ".join(f"{name} {100 * bias.after_by_name[name]:.2f} %" for name in HEALTH)
    small = all(bias.after_by_name[name] <= (0.03 if name == "h_tot" else 0.01) for name in HEALTH)
    value = f"{100 * bias.before:.2f} -> {100 * bias.after:.2f} % (/ {bias.factor:.1f}; {after}; {bias.cases})"
    if bias.oracle is not None:
        value += f"; the oracle's {100 * bias.oracle:.2f} % (/ {bias.before / max(bias.oracle, 1e-12):.1f})"
    numbers = {"before": bias.before, "after": bias.after, "factor": bias.factor, "oracle": bias.oracle,
               "after_by_name": bias.after_by_name,
               "before_by_name": bias.before_by_name, "of": bias.cases}  # fmt: skip
    return Line("health", _HEALTH, value, "/ 4", _HEALTH_AIM, bias.factor >= 4.0, bias.factor >= 10.0 and small,
                numbers)  # fmt: skip


def _gain(values: np.ndarray, small: int) -> Line:
    if not values.size:
        return Line("gain", "held-out gain / oracle's, median (p10)", MISSING, ">= 0.90", ">= 0.98, p10 >= 0.9", None,
                    None, {})  # fmt: skip
    p10, half = np.quantile(values, [0.1, 0.5])
    return Line("gain", "held-out gain / oracle's, median (p10)",
                f"{half:.3f} (p10 {p10:.3f}; {values.size}, {small} too small)", ">= 0.90", ">= 0.98, p10 >= 0.9",
                bool(half >= 0.90), bool(half >= 0.98 and p10 >= 0.90),
                {"median": float(half), "p10": float(p10), "of": int(values.size), "too_small": small})  # fmt: skip


def _time(seconds: np.ndarray) -> Line:
    if not seconds.size:
        return Line("time", "seconds a recording, median / most", MISSING, "<= 300 s", "<= 60 s", None, None, {})
    half, most = float(np.median(seconds)), float(seconds.max())
    return Line("time", "seconds a recording, median / most", f"{half:.1f} / {most:.1f} s", "<= 300 s", "<= 60 s",
                most <= 300.0, most <= 60.0, {"median": half, "most": most, "of": int(seconds.size)})  # fmt: skip


def extra(rows: Sequence[CaseRow]) -> dict[str, Share]:
    """Further counts, for people who want to know where the lines come from."""
    found: dict[str, Share] = {}
    for kind in ("single", "partial", "two", "withheld"):
        of_kind = [row for row in rows if row.kind == kind]
        found[f"detection at >= 3 x: {kind}"] = metrics.detection(of_kind)
        found[f"site right: {kind}"] = metrics.sites(of_kind)
        if kind != "withheld":
            found[f"name in the set: {kind}"] = metrics.names_in_set(of_kind)
    everywhere = [row for row in rows if row.truth]
    found["mismatch at any magnitude"] = Share(sum(row.mismatch for row in everywhere), len(everywhere))
    for sort in ("onset", "region"):
        found[f"detection at >= 3 x: {sort}"] = metrics.detection([row for row in rows if row.partial == sort])
    found["first name right, separable, at any magnitude"] = metrics.top_names(rows, any_size=True)
    found["first name right, separable or not"] = metrics.top_names_unconditioned(rows)
    found["withheld -> none, where no other name imitates it (D >= 9)"] = metrics.withheld_none(rows, True)
    found["law within 10 %, faults of flows, powers and temperatures"] = metrics.laws(rows, right_hand_side=True)
    found["the oracle's law within 10 % (the form told, the size fitted)"] = metrics.oracle_laws(rows)
    found["law within 10 % where the oracle's is, or there is no oracle"] = metrics.laws_where_oracle(rows)
    found["false alarms, unstable region"] = metrics.false_alarms([r for r in rows if r.route == "unstable"])
    found["no result"] = Share(sum(row.problem is not None for row in rows), len(rows))
    return found


def _mark(reached: bool | None) -> str:
    return "-" if reached is None else ("yes" if reached else "**no**")


def markdown(
    title: str, tool: Sequence[CaseRow], baselines: Mapping[str, Sequence[CaseRow]], notes: Sequence[str]
) -> str:
    """The report of a score: the table, baselines on their subset, further counts, failures by kind."""
    out = [f"# {title}", "", *notes, "", "| metric | value | pass | | aim | |", "|---|---|---|---|---|---|"]
    for line in lines(tool):
        out.append(f"| {line.metric} | {line.value} | {line.pass_at} | {_mark(line.passed)} | {line.aim} | "
                   f"{_mark(line.aimed)} |")  # fmt: skip
    out += ["", "Shares with counts and Clopper-Pearson intervals (95 %).", ""]
    if baselines:
        names = list(baselines)
        cases = {row.case for rows in baselines.values() for row in rows}
        table = {name: {line.key: line for line in lines(rows)} for name, rows in baselines.items()}
        out += [f"## Baselines, on the same {len(cases)} cases", "", "| metric | " + " | ".join(names) + " |",
                "|---" * (len(names) + 1) + "|"]  # fmt: skip
        for line in lines(tool):
            cells = [table[name][line.key].value for name in names]
            out.append(f"| {line.metric} | " + " | ".join(_cell(name, line.key, cell) for name, cell in
                                                          zip(names, cells, strict=True)) + " |")  # fmt: skip
        out.append("")
    if any(row.since_said for row in tool):
        out += ["## An oracle that knows the plant's maps and the form of the effect", "", "| metric | oracle |",
                "|---|---|"]
        told = {line.key: line for line in lines([oracle_row(row) for row in tool if row.oracle_health])}
        out += [f"| {told[key].metric} | {told[key].value} |" for key in _ORACLE_SAYS if key in told]
        out.append("")
    out += ["## Where it comes from", "", "| count | value |", "|---|---|"]
    out += [f"| {name} | {share} |" for name, share in extra(tool).items()]
    found = metrics.failures(tool)
    kinds: dict[str, int] = {}
    for failure in found:
        kinds[str(failure["failure"])] = kinds.get(str(failure["failure"]), 0) + 1
    out += ["", "## Failures by kind", "", "| kind | count |", "|---|---|"]
    listed = sorted(kinds.items(), key=lambda item: -item[1]) or [("none", 0)]
    out += [f"| {kind} | {count} |" for kind, count in listed]
    return "\n".join(out) + "\n"


_ORACLE_SAYS = ("magnitude", "health", "gain", "since")

_SAYS = {
    "health only": {"false_alarms", "detection", "time"},
    "Kalman": {"false_alarms", "detection", "site", "time"},
    "neural": {"false_alarms", "detection", "gain", "time"},
    "oracle": {"magnitude", "health", "gain"},
}
"""What a baseline can say at all; an oracle is told what a tool must find."""


def _cell(name: str, key: str, value: str) -> str:
    return value if name not in _SAYS or key in _SAYS[name] else "cannot say"
