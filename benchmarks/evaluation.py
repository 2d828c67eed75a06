"""Ensembles against the paper's cells: exact formulae and spline bodies, or `--models`; Case-V of `make run`.

    python benchmarks/evaluation.py --methods classical few-shot-newton --members 30
    python benchmarks/evaluation.py --methods few-shot-adam multi-stage --members 3 --cases noisy-301 --models models
    python benchmarks/evaluation.py --methods classical --channels p_im_pa p_em_pa omega_t_rad_s --cases noisy-301

`python -m flows.evaluate` makes the whole tables, with everything learned; this is the short way to one figure of them.
Needs data/field/case_v_clean.parquet (`python -m flows.simulate`).
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from dieseltwin.engine import HEALTH, MEASURED
from dieseltwin.identification.bound import cramer_rao
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import PAPER_CHANNELS, NoiseLevels, problems_from_recording
from dieseltwin.paper.datasets import laboratory_parameters
from dieseltwin.paper.evaluation import tables as evaluation
from dieseltwin.paper.evaluation.ensembles import CASES, case_problems, member_table
from dieseltwin.recordings.reader import read_recording
from dieseltwin.sensors import relative_noise
from dieseltwin.settings.methods import EXACT, find, in_order, names
from dieseltwin.settings.params import load_params
from dieseltwin.surrogates.files import networks_for

LEARNED = tuple(method.name for method in in_order() if method.needs.maps != EXACT)
"""Methods that run with what `--models` holds; the others have exact formulae and bodies of their own."""
STATES = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "x_r", "t_1_k"]


def clean_problems(path: Path, params: Any) -> list[Any]:
    """The first five minutes of the clean field recording, with truth and true initial states."""
    parameters = laboratory_parameters(params.engine)
    frame = pd.read_parquet(path)
    noise = NoiseLevels.from_signals(frame[list(MEASURED)].to_numpy(), relative=relative_noise(params.noise))
    truth = {name: float(frame[name].iloc[0]) for name in HEALTH}
    recording = read_recording(path, engine=parameters)
    problems = problems_from_recording(recording, parameters, noise=noise, channels=PAPER_CHANNELS, truth=truth)[:5]
    rows = np.searchsorted(frame["time_s"], [p.t0_s - 1e-6 for p in problems])
    initial = frame[STATES].to_numpy()[rows]
    return [replace(p, true_initial=row) for p, row in zip(problems, initial, strict=True)]


def networks(method: str, folder: Path | None, left_out: Sequence[str]) -> dict[str, Any]:
    """What a method of `LEARNED` needs of a folder's networks, with the paper's maps, less those left out."""
    if folder is None or method not in LEARNED:
        return {}
    return {kind: net for kind, net in networks_for(find(method), folder, "paper").items() if kind not in left_out}


def main() -> None:
    """Run the ensembles and print scores, cells and calibration."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=list(names()), default=["classical", "few-shot-newton"])
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--members", type=int, default=30)
    parser.add_argument("--channels", nargs="+", default=None, help="sensors; all five without it")
    parser.add_argument("--profile", default="quick", help="whose epochs and settings")
    parser.add_argument(
        "--models", type=Path, default=None, help=f"folder of trained networks, for {', '.join(LEARNED)}"
    )
    parser.add_argument("--leave-out", nargs="+", default=[], help="of bodies, maps, operators")
    parser.add_argument("--scale-x-r", type=float, default=None, help="unit of the residual of x_r")
    parser.add_argument("--average-share", type=float, default=None, help="of the epochs; 0 is the last epoch")
    parser.add_argument("--fixed-dropout", action="store_true", help="one realisation of the maps a run")
    parser.add_argument("--seed", type=int, default=1, help="of starts, masks and weights")
    parser.add_argument("--noise-seed", type=int, default=1001, help="of the readings' noise; another one than --seed")
    parser.add_argument("--recording", type=Path, default=Path("data/field/case_v_clean.parquet"))
    arguments = parser.parse_args()
    if arguments.models is not None and not set(arguments.methods) & set(LEARNED):
        parser.error(
            f"--models: none of {', '.join(arguments.methods)} uses it; name {' or '.join(LEARNED)}, or leave it out"
        )

    if arguments.noise_seed == arguments.seed:
        parser.error("--noise-seed: starts and noise would come from one stream; choose another one than --seed")

    params = load_params(None, arguments.profile)
    clean = clean_problems(arguments.recording, params)
    truth = dict(clean[0].truth)
    changed: dict[str, Any] = {"fresh_dropout": not arguments.fixed_dropout}
    if arguments.scale_x_r is not None:
        changed["scale_x_r"] = arguments.scale_x_r
    if arguments.average_share is not None:
        changed["average_share"] = arguments.average_share
    config = params.identify
    for name in LEARNED:
        config = config.changed(name, **changed)
    with tempfile.TemporaryDirectory() as temporary:
        for case in arguments.cases:
            problems = case_problems(clean, case, arguments.members, arguments.noise_seed, arguments.channels)
            true = np.array([truth[name] for name in HEALTH])
            bounds = [cramer_rao([p], true, np.asarray(p.true_initial)[:3])[0].relative for p in problems]
            for method in arguments.methods:
                learned = networks(method, arguments.models, arguments.leave_out)
                began = time.process_time()
                found = identify_segments(problems, method, arguments.members, arguments.seed, config=config, **learned)
                cpu = (time.process_time() - began) / (arguments.members * len(problems))
                print(f"{method}, {case}: {cpu:.3f} CPU s per run", flush=True)
                folder = Path(temporary) / f"{case}-{method}"
                folder.mkdir()
                member_table(found.segments, truth, bounds, arguments.seed).to_parquet(folder / "members.parquet")
                about = {"method": method, "case": case, "channels": arguments.channels}
                (folder / "ensemble.json").write_text(json.dumps(about), encoding="utf-8")
        ensembles = evaluation.load_ensembles(Path(temporary))
    table = evaluation.cells(ensembles)
    shown = table.assign(rmse_pct=100.0 * table["rmse"], bound_pct=100.0 * table["bound"])
    columns = ["method", "case", "minute", "parameter", "mean", "std", "rmse_pct", "bound_pct", "converged", "diverged",
               "p", "coverage"]  # fmt: skip
    print(shown[columns].to_string(index=False, float_format=lambda v: f"{v:.4g}"))
    beside = evaluation.beside_paper(table)
    print(evaluation.scores(beside, ensembles, 4000).to_string(index=False, float_format=lambda v: f"{v:.3g}"))
    print(evaluation.calibration(ensembles).to_string(index=False, float_format=lambda v: f"{v:.3g}"))


if __name__ == "__main__":
    main()
