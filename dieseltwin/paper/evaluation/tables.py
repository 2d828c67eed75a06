"""The paper's tables from our ensembles, each beside what the paper prints; numbers only, words and page are elsewhere.

Everything is computed from files: one folder for each ensemble with ``members.parquet`` (see
`ensembles.member_table`), ``ensemble.json`` and ``runtime.json``, so that any table can be made again.
Definitions (docs/evaluation.md): RMSE = sqrt((mean - 1)^2 + std^2) per cell, cells that are not
identifiable are listed and not scored. A member that diverged is counted; a cell with one is never better than the
paper's.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from dieseltwin.errors import InputError
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW
from dieseltwin.paper import printed
from dieseltwin.paper.cells import cell_rmse

BOUND_SCORED = 0.10
"""Relative bound below which a cell is scored [-]. Between this and 25 % a cell can be told, but so weakly that
the runs' noise says more than the method: such cells are shown and not scored."""
CONFIDENCE = 0.95
"""Of the bootstrap intervals."""
POINTS = 12
"""Epochs of a run at which its error is told."""
CELL = ["case", "minute", "parameter"]


@dataclass(frozen=True)
class Ensemble:
    """The members of one method on one case.

    Attributes:
        method, case: names; variant: what was changed, "" for the paper's own ensembles.
        members: table of `member_table`.
        about: ensemble.json (seed, batches, epochs, channels).
        seconds: (segments,) wall seconds per run [s].
        curves: convergence in long form, or None.
    """

    method: str
    case: str
    variant: str
    members: pd.DataFrame
    about: Mapping[str, Any] = field(default_factory=dict)
    seconds: tuple[float, ...] = ()
    curves: pd.DataFrame | None = field(default=None, repr=False)


def load_ensembles(root: Path) -> list[Ensemble]:
    """Read every ensemble below a folder, sorted by variant, case and method.

    Errors: InputError where there is none.
    """
    made = []
    # not **: it doesn't enter linked folders, and a pipeline links results instead of copying them
    patterns = ("ensemble.json", "*/ensemble.json", "*/*/ensemble.json")
    for path in sorted({path for pattern in patterns for path in Path(root).glob(pattern)}):
        about = json.loads(path.read_text(encoding="utf-8"))
        runtime = path.with_name("runtime.json")
        seconds = json.loads(runtime.read_text(encoding="utf-8"))["seconds_per_run"] if runtime.exists() else []
        curves = path.with_name("curves.parquet")
        made.append(
            Ensemble(
                about["method"], about["case"], about.get("variant", ""),
                pd.read_parquet(path.with_name("members.parquet")), about, tuple(seconds),
                pd.read_parquet(curves) if curves.exists() else None,
            )
        )  # fmt: skip
    if not made:
        raise InputError(str(root), "no ensemble.json below it", "results of flows.evaluate", "run it first")
    order = [*printed.PARAMETER_TABLES[printed.FEW_SHOT]]
    return sorted(made, key=lambda e: (e.variant, order.index(e.case), e.method))


def minute_of(t0_s: float, t1_s: float) -> str:
    """Name of a minute as the paper's tables have it, e.g. "2-3"."""
    return f"{t0_s / 60:.4g}-{t1_s / 60:.4g}"


def cells(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """One row for each variant, method, case, minute and parameter.

    Returns:
        Columns variant, method, case, minute, parameter; mean, std, rmse (over the truth, members that did not
        diverge); members, converged, diverged (counts); bound (relative, at the truth), bound_class ("scored" below
        10 %, "identifiable" to 25 %, "not identifiable"); flagged (share of members whose method says "not identifiable
        here"); t, p of the one-sample t-test of mean = 1 (two-sided); coverage of the members' own 90 % intervals.
    """
    rows = []
    for e in ensembles:
        for (t0, t1, parameter), part in e.members.groupby(["t0_s", "t1_s", "parameter"], sort=True):
            kept = part[~part["diverged"]]
            ratios = kept["ratio"].to_numpy(dtype=float)
            test = stats.ttest_1samp(ratios, 1.0) if len(ratios) > 1 and np.ptp(ratios) > 0.0 else None
            bound = float(part["bound"].iloc[0])
            known = kept[np.isfinite(kept["std"])]
            inside = (known["low"] <= 1.0) & (known["high"] >= 1.0)
            rows.append(
                {
                    "variant": e.variant,
                    "method": e.method,
                    "case": e.case,
                    "minute": minute_of(t0, t1),
                    "parameter": parameter,
                    "mean": float(np.mean(ratios)) if len(ratios) else math.nan,
                    "std": float(np.std(ratios, ddof=1)) if len(ratios) > 1 else math.nan,
                    "rmse": cell_rmse(ratios),
                    "members": len(part),
                    "converged": int(part["converged"].sum()),
                    "diverged": int(part["diverged"].sum()),
                    "bound": bound,
                    "bound_class": bound_class(bound),
                    "flagged": float(1.0 - part["identifiable"].mean()),
                    "t": math.nan if test is None else float(test.statistic),
                    "p": math.nan if test is None else float(test.pvalue),
                    "coverage": float(inside.mean()) if len(known) else math.nan,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def bound_class(bound: float) -> str:
    """Whether a cell with that relative bound is scored, only identifiable, or neither."""
    if bound < BOUND_SCORED:
        return "scored"
    return "identifiable" if bound <= IDENTIFIABLE_BELOW else "not identifiable"


def beside_paper(table: pd.DataFrame) -> pd.DataFrame:
    """Our cells beside the paper's: columns of `cells` and table, paper_mean, paper_std, paper_rmse, paper_p, ratio.

    ``ratio`` is our RMSE over the paper's; ``better`` says that it is at most 1 with no member diverged. Rows of
    methods and minutes that the paper has no table for are left out.
    """
    own = table[table["variant"] == ""]
    theirs = printed.parameter_cells().rename(columns={"mean": "paper_mean", "std": "paper_std", "rmse": "paper_rmse"})
    # The paper's minute 0-1 of multi-stage is the hybrid PINN from scratch.
    first = own[(own["method"] == "baseline") & (own["minute"] == printed.MINUTES[0])].assign(method="multi-stage")
    own = pd.concat([own[own["method"] != "baseline"], first]).drop_duplicates(["method", *CELL], ignore_index=True)
    pairs = [(method, name) for method in own["method"].unique() for name in printed.counterpart(method)]
    found = own.merge(pd.DataFrame(pairs, columns=["method", "table"]), on="method").merge(theirs, on=["table", *CELL])
    standard_error = (found["paper_std"] / math.sqrt(printed.RUNS)).replace(0.0, np.nan)
    statistic = (found["paper_mean"] - 1.0) / standard_error
    found["paper_p"] = 2.0 * stats.t.sf(statistic.abs(), printed.RUNS - 1)
    found["ratio"] = found["rmse"] / found["paper_rmse"]
    found["better"] = (found["ratio"] <= 1.0) & (found["diverged"] == 0)
    return found


def score_of(scored: pd.DataFrame) -> dict[str, Any]:
    """Cells, better (share) and ratio (geometric mean) of some rows of `beside_paper`."""
    with np.errstate(divide="ignore"):
        ratio = float(np.exp(np.mean(np.log(scored["ratio"]))))
    return {"cells": len(scored), "better": float(scored["better"].mean()), "ratio": ratio}


def scores(beside: pd.DataFrame, ensembles: Sequence[Ensemble], resamplings: int) -> pd.DataFrame:
    """How each method does against each printed table, over the cells with a bound below 10 %.

    The interval of the geometric-mean ratio comes from drawing the members of every cell anew; the same gives each cell
    an interval of its own, and a cell is "worse beyond its interval" where the whole of that lies above 1.

    Returns:
        One row for each method, table and case ("all" for them together): cells, better (share), ratio (geometric
        mean), low, high (95 %), worse_beyond (count), diverged (members), unscored (cells).
    """
    rng = np.random.default_rng(0)
    draws = {}
    for e in ensembles:
        if e.variant:
            continue
        for (t0, t1, parameter), part in e.members.groupby(["t0_s", "t1_s", "parameter"]):
            name = "multi-stage" if e.method == "baseline" else e.method
            ratios = part.loc[~part["diverged"], "ratio"].to_numpy(dtype=float)
            key = (name, e.case, minute_of(t0, t1), parameter)
            if e.method != "baseline" or key not in draws:
                draws[key] = _resampled_rmse(ratios, resamplings, rng)
    rows = []
    for (method, table), whole in beside.groupby(["method", "table"], sort=True):
        cases = list(whole["case"].unique())
        for case in ["all", *(cases if len(cases) > 1 else [])]:
            part = whole if case == "all" else whole[whole["case"] == case]
            scored = part[part["bound_class"] == "scored"]
            if scored.empty:
                continue
            again = np.stack([draws[method, r.case, r.minute, r.parameter] for r in scored.itertuples()])
            relative = again / scored["paper_rmse"].to_numpy()[:, None]
            with np.errstate(divide="ignore"):
                means = np.exp(np.mean(np.log(relative), axis=0))
            tail = 0.5 * (1.0 - CONFIDENCE)
            low, high = np.quantile(means, [tail, 1.0 - tail])
            rows.append(
                {
                    "method": method, "table": table, "case": case, **score_of(scored),
                    "low": float(low), "high": float(high),
                    "worse_beyond": int((np.quantile(relative, tail, axis=1) > 1.0).sum()),
                    "diverged": int(part["diverged"].sum()), "unscored": len(part) - len(scored),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def _resampled_rmse(ratios: NDArray[np.float64], resamplings: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(resamplings,) RMSE of members drawn with replacement; variances by n / (n - 1), or few members look too sure."""
    if not len(ratios):
        return np.full(resamplings, np.nan)
    count = len(ratios)
    again = ratios[rng.integers(0, count, (resamplings, count))]
    if count == 1:
        return np.abs(again[:, 0] - 1.0)
    wider = math.sqrt(count / (count - 1))
    middle = float(ratios.mean())
    mean = middle + wider * (again.mean(axis=1) - middle)
    return np.hypot(mean - 1.0, wider * again.std(axis=1, ddof=1))


def run_times(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Wall seconds per run beside the printed ones.

    Columns: method, case, minute, seconds, epochs, paper_epochs, paper, paper_std, ratio (paper over ours). The paper's
    machine is another one, so the ratio is for scale; `benchmarks/paper_loop.py` compares on one machine.
    """
    rows = []
    for e in ensembles:
        if e.variant or not e.seconds:
            continue
        segments = e.members[["t0_s", "t1_s"]].drop_duplicates().sort_values("t0_s")
        for (t0, t1), seconds in zip(segments.itertuples(index=False), e.seconds, strict=True):
            minute = minute_of(t0, t1)
            found = printed.TIMES.get((e.method, minute))
            times = {"clean-151": found.clean_151, "noisy-301": found.noisy_301}.get(e.case) if found else None
            rows.append(
                {
                    "method": e.method, "case": e.case, "minute": minute, "seconds": seconds,
                    "epochs": e.about.get("epochs"), "paper_epochs": found.epochs if found else None,
                    "paper": times[0] if times else math.nan, "paper_std": times[1] if times else math.nan,
                    "ratio": times[0] / seconds if times and seconds > 0.0 else math.nan,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def training_errors(
    operators: Mapping[str, Sequence[Mapping[str, Any]]], bodies: Sequence[Mapping[str, Any]]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors of repeated trainings beside the printed ones [%].

    Args:
        operators: "clean" or "noisy" labels -> one errors document of each training.
        bodies: one errors document of each training.

    Returns:
        Operators: labels, output, recording, trainings, mean, std, paper, paper_std. Bodies: output and the same.
    """
    rows = []
    for (labels, output, recording), paper in printed.OPERATOR_ERRORS.items():
        values = [float(document[output][recording]) for document in operators.get(labels, ())]
        rows.append({"labels": labels, "output": output, "recording": recording, **_spread(values, paper)})
    of_bodies = [
        {"output": output, **_spread([float(document[output]["train"]) for document in bodies], paper)}
        for output, paper in printed.BODY_ERRORS.items()
    ]
    return pd.DataFrame(rows), pd.DataFrame(of_bodies)


def _spread(values: Sequence[float], paper: printed.Cell) -> dict[str, float]:
    return {
        "trainings": len(values),
        "mean": float(np.mean(values)) if values else math.nan,
        "std": float(np.std(values, ddof=1)) if len(values) > 1 else math.nan,
        "paper": paper[0],
        "paper_std": paper[1],
    }


def calibration(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Whether stated uncertainty is what it says, on noisy data: per method, variant and parameter.

    Columns: stated_by, intervals (how many, identifiable cells only), coverage (share of 90 % intervals that hold the
    truth), z_std (standard deviation of error over stated deviation, 1 if honest), z_mean (bias in stated deviations).
    Methods that state none (Adam) have one interval a minute, from the spread of the members: `z_mean` is then bias
    over spread, and `z_std`, which would be 1 by construction, NaN.
    """
    rows = []
    for e in ensembles:
        if e.case != "noisy-301":
            continue
        for parameter, part in e.members.groupby("parameter", sort=True):
            usable = part[~part["diverged"] & (part["bound"] <= IDENTIFIABLE_BELOW)]
            stated = usable[np.isfinite(usable["std"]) & usable["identifiable"]]
            own = len(stated) > 0
            if own:
                z = (stated["ratio"] - 1.0) / stated["std"]
                inside = float(((stated["low"] <= 1.0) & (stated["high"] >= 1.0)).mean())
            else:
                groups = usable.groupby("segment")["ratio"]
                spread = groups.transform("std").replace(0.0, np.nan)
                z = ((usable["ratio"] - 1.0) / spread).dropna()
                ends = groups.quantile([0.05, 0.95]).unstack()
                inside = float(((ends[0.05] <= 1.0) & (ends[0.95] >= 1.0)).mean()) if len(ends) else math.nan
                z = z.groupby(usable["segment"]).mean()
            rows.append(
                {
                    "variant": e.variant, "method": e.method, "parameter": parameter,
                    "stated_by": "method" if own else "spread of members", "intervals": len(z), "coverage": inside,
                    "z_mean": float(z.mean()) if len(z) else math.nan,
                    "z_std": float(z.std()) if own and len(z) > 1 else math.nan,
                }
            )  # fmt: skip
    columns = ["variant", "method", "parameter", "stated_by", "intervals", "coverage", "z_mean", "z_std"]
    return pd.DataFrame(rows, columns=columns)  # named, for a run without a noisy case has no rows


def over_epochs(ensembles: Sequence[Ensemble], truth: Mapping[str, float]) -> pd.DataFrame:
    """RMSE of each parameter along the training on noisy data, over members and the minutes that are scored.

    Columns: variant, method, epoch, parameter, rmse (over the truth).
    """
    rows = []
    for e in ensembles:
        if e.case != "noisy-301" or e.curves is None or e.about.get("last_epoch"):
            continue
        bounds = e.members.groupby(["segment", "parameter"])["bound"].first()
        last = int(e.curves["epoch"].max())
        for parameter in printed.PARAMETERS:
            curve = e.curves[e.curves["quantity"] == parameter]
            known = [s for s in curve["segment"].unique() if bounds.get((s, parameter), math.inf) < BOUND_SCORED]
            error = curve[curve["segment"].isin(known)].assign(
                square=lambda frame, p=parameter: (frame["value"] / truth[p] - 1.0) ** 2
            )
            rmse = np.sqrt(error.groupby("epoch")["square"].mean())
            for share in np.linspace(1.0 / POINTS, 1.0, POINTS):
                epoch = _nearest(rmse.index.to_numpy(), share * last)
                if epoch is not None:
                    rows.append({"variant": e.variant, "method": e.method, "epoch": epoch, "parameter": parameter,
                                 "rmse": float(rmse[epoch])})  # fmt: skip
    return pd.DataFrame(rows, columns=["variant", "method", "epoch", "parameter", "rmse"])


def _nearest(epochs: NDArray[Any], wanted: float) -> Any:
    return epochs[int(np.argmin(np.abs(epochs - wanted)))] if len(epochs) else None


def identifiability(ensembles: Sequence[Ensemble]) -> pd.DataFrame:
    """Bound of each minute and parameter by case and sensors: case, sensors, minute, parameter, bound, bound_class."""
    rows: dict[tuple[str, str, str, str], float] = {}
    for e in ensembles:
        sensors = ", ".join(e.about.get("channels") or ()) or "all five"
        firsts = e.members.groupby(["t0_s", "t1_s", "parameter"])["bound"].first()
        for (t0, t1, parameter), bound in firsts.items():  # type: ignore[misc]
            rows.setdefault((e.case, sensors, minute_of(t0, t1), parameter), float(bound))
    table = pd.DataFrame(
        [(*key, value, bound_class(value)) for key, value in sorted(rows.items())],
        columns=["case", "sensors", "minute", "parameter", "bound", "bound_class"],
    )
    return table


def metrics(score: pd.DataFrame, calibrated: pd.DataFrame, table: pd.DataFrame) -> dict[str, dict[str, float | None]]:
    """What MLflow shows of each method: ``better_pct`` and ``rmse_ratio`` by printed table, coverage, failures."""
    found: dict[str, dict[str, float | None]] = {}
    short = {printed.MULTI_STAGE: "multi_stage_table", printed.FEW_SHOT: "few_shot_table"}
    for row in score[score["case"] == "all"].itertuples():
        own = found.setdefault(row.method, {})
        own[f"{short[row.table]}/better_pct"] = _number(100.0 * row.better)
        own[f"{short[row.table]}/rmse_ratio"] = _number(row.ratio)
    stated = (calibrated["variant"] == "") & (calibrated["stated_by"] == "method")
    for row in calibrated[stated].itertuples():
        found.setdefault(row.method, {})[f"coverage/{row.parameter}"] = _number(row.coverage)
    for (method, case), part in table[table["variant"] == ""].groupby(["method", "case"]):
        own = found.setdefault(method, {})
        own[f"diverged_share/{case}"] = _number(part["diverged"].sum() / max(1, part["members"].sum()))
        for parameter, cell in part[part["bound_class"] == "scored"].groupby("parameter"):
            own[f"rmse_pct/{case}/{parameter}"] = _number(100.0 * cell["rmse"].median())
    return found


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
