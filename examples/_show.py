"""Runs a small twin's discovery on the earlier half of its recording, judges it on the later half, and draws it."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from dieseltwin.atomic import write_json
from dieseltwin.discovery.search.stepwise import discover_stepwise, free_run, metric_of, repaired


def find(relative):
    """The recording under $DIESELTWIN_DATA, else ../shared/data; the first argument of the command line wins."""
    given = [Path(arg) for arg in sys.argv[1:2]]
    roots = [os.environ.get("DIESELTWIN_DATA"), Path(__file__).parents[2] / "shared" / "data"]
    for path in [*given, *(Path(root) / relative for root in roots if root)]:
        if path.is_file():
            return path
    sys.exit(f"no recording {relative}: set DIESELTWIN_DATA to the folder that holds it, or pass the file")


def evaluate(make, path, window_s, held_window_s, floor, fitted_rows=None, **options):
    """Story of the earlier half, and the later half as measured, before, with names, with names and law."""
    whole = make(path)
    n = len(whole.time_s)
    earlier = whole.windowed(window_s, slice(0, n // 2))
    story = discover_stepwise(earlier, floor=floor, judged_window_s=held_window_s, **options)
    held = whole.windowed(held_window_s, slice(n // 2, n))
    whitening = metric_of(held, floor)
    runs = {"before": free_run(held, replace(story.before, local=held.first_local()), whitening, fitted_rows)}
    runs["names"] = free_run(*repaired(held, story, law=False), whitening, fitted_rows)
    if story.law is not None:
        runs["names and law"] = free_run(*repaired(held, story), whitening, fitted_rows)
    skipped = fitted_rows or 0
    errors = {k: float(np.sqrt(np.nanmean((held.measured - run)[skipped:] ** 2))) for k, run in runs.items()}
    return story, held, runs, errors


def show(make, relative, published, window_s, held_window_s, floor, unit, fitted_rows=None):
    """Prints and draws what was left out, and the error on the half that no fit has seen."""
    path = find(relative)
    story, held, runs, errors = evaluate(make, path, window_s, held_window_s, floor, fitted_rows)
    print("Left out, found on the earlier half:")
    for sentence in story.sentences():
        print(f"  {sentence}")
    names = [p.name for p in held.parameters]
    for label, fit in (("before", story.before), ("after", story.after)):
        print(f"Parameters {label}: " + ", ".join(f"{k} {v:.4g}" for k, v in zip(names, fit.parameters, strict=False)))
    if story.law is not None:
        for rival in story.law.rivals:
            print(f"  a law {rival.behind:.1f} units behind: {rival.text}")
    how = "free run" if held_window_s is None else f"runs of {held_window_s:g} s"
    print(f"Later half, {how}: rms error " + ", ".join(f"{k} {v:.4g} {unit}" for k, v in errors.items()))
    print(published)
    options = {"withhold": tuple(held.hypotheses)}
    blind, _, _, blind_errors = evaluate(make, path, window_s, held_window_s, floor, fitted_rows, **options)
    print("The same without any catalogue: " + "; ".join(blind.sentences()))
    print("  rms error " + ", ".join(f"{k} {v:.4g} {unit}" for k, v in blind_errors.items() if k != "names"))
    write_json(Path("reports") / f"{Path(relative).parent.name}.json", story.to_json())
    draw(Path(relative).parent.name, story, held, runs, errors, unit)


def draw(name, story, held, runs, errors, unit):
    """Measured against simulated over the later half, and the errors below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (above, below) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, constrained_layout=True)
    above.plot(held.time_s, held.measured[:, 0], color="black", linewidth=1.5, label="measured")
    for (label, run), color in zip(runs.items(), ("tab:red", "tab:blue", "tab:green"), strict=False):
        above.plot(held.time_s, run[:, 0], color=color, linewidth=1.0, label=f"{label}: rms {errors[label]:.3g} {unit}")
        below.plot(held.time_s, run[:, 0] - held.measured[:, 0], color=color, linewidth=1.0)
    above.set_ylabel(f"{held.channels[0]} [{unit}]")
    below.set_ylabel(f"simulated - measured [{unit}]")
    below.set_xlabel("time [s]")
    below.axhline(0.0, color="grey", linewidth=0.5)
    above.set_title("; ".join(f"{s.name} ({s.site})" for s in story.steps) or "nothing named", fontsize=10)
    above.legend(fontsize=8)
    target = Path("reports") / f"{name}.png"
    target.parent.mkdir(exist_ok=True)
    figure.savefig(target, dpi=110)
    print(f"Figure: {target}")
