"""Actuator operators and multi-head bodies beside the paper's tables: errors, floors, epochs, seconds.

    python benchmarks/pretraining.py                       # quick profile; held out: validation driving
    python benchmarks/pretraining.py --case-v              # and Case-V, once per released version (docs/definitions.md)
    python benchmarks/pretraining.py --noise 0.03          # operators trained on labels with 3 % noise

Seconds are CPU seconds of one thread, training only; the data are simulated first.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from dieseltwin.paper.datasets import laboratory_parameters, make_case, make_validation
from dieseltwin.paper.printed import BODY_ERRORS, operator_errors
from dieseltwin.settings.params import Params, load_params
from dieseltwin.surrogates.bodies import Kind, pod_floor, train_bodies
from dieseltwin.surrogates.operators import COMMANDS, OPERATORS, train_operators

VALIDATION_SEEDS = (901, 902)
CASES = ("case_i", "case_iv", "case_vi", "case_vii")
PRINTED_AS = {
    "p_im_pa": "p_im", "p_em_pa": "p_em", "x_r": "x_r", "t_1_k": "T_1", "omega_t_rad_s": "omega_t",
    "u_egr1_pct": "u_egr1", "u_egr2_pct": "u_egr2", "u_vgt_act_pct": "u_vgt",
}  # fmt: skip
"""Column -> name in the paper's tables of errors."""


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table with columns as wide as they need."""
    cells = [[f"{c:.3f}" if isinstance(c, float) else str(c) for c in row] for row in [header, *rows]]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    print(f"\n{title}")
    for row in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))


def recording(name: str, params: Params, folder: Path | None) -> pd.DataFrame:
    """A case or "val_<seed>", from the folder where it is there already."""
    path = None if folder is None else folder / f"{name}.parquet"
    if path is not None and path.is_file():
        return pd.read_parquet(path)
    frame = make_validation(int(name[4:]), params)[0] if name.startswith("val_") else make_case(name, params)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        frame.to_parquet(path)
    return frame


def command_error(frame: pd.DataFrame, label: str) -> float:
    """Relative L2 error [%] of taking the command itself for the state: what an operator must beat."""
    column = next(COMMANDS[name] for name, labels in OPERATORS.items() if label in labels)
    truth = frame[label].to_numpy()
    return 100.0 * float(np.linalg.norm(frame[column].to_numpy() - truth) / np.linalg.norm(truth))


def operators(
    params: Params,
    seeds: Sequence[int],
    noise: float,
    cases: Mapping[str, pd.DataFrame],
    held: Mapping[str, pd.DataFrame],
) -> None:
    """Train and score D1 and D2."""
    config = params.pretrain.operators
    if noise:
        config = config.model_copy(update={"finish_ridge": 1e-5})
    trained, seconds = [], []
    for seed in seeds:
        start = time.process_time()
        trained.append(
            train_operators(cases, config, seed, laboratory_parameters(params.engine), label_noise_rel=noise)
        )
        seconds.append(time.process_time() - start)
    rows = []
    for name, labels in OPERATORS.items():
        for label in labels:
            errors = {"train": [o.errors(cases["case_i"])[label] for o in trained]}
            errors |= {where: [o.errors(frame)[label] for o in trained] for where, frame in held.items()}
            shown = [f"{np.mean(values):.3f}+-{np.std(values):.3f}" for values in errors.values()]
            command = [f"{command_error(frame, label):.2f}" for frame in held.values()]
            paper = [operator_errors(where)[PRINTED_AS[label]][0] for where in ("train", "test")]
            rows.append([name, label, *shown, " ".join(command), *paper])
    updates = f"{config.egr.updates} / {config.vgt.updates} updates on {config.egr.batch} rows"
    table(
        f"Actuator operators, relative L2 [%], {len(seeds)} seeds, {noise:.0%} label noise, {updates}, "
        f"finish on {config.finish_rows} rows, {np.mean(seconds):.1f} s each",
        ["net", "state", "Case-I", *held, "the command itself", "paper train", "paper test"],
        rows,
    )


def bodies(
    params: Params,
    kind: Kind,
    seeds: Sequence[int],
    cases: Mapping[str, pd.DataFrame],
    held: Mapping[str, pd.DataFrame],
) -> None:
    """Train and score the four bodies of one kind."""
    config, seconds, trained = params.pretrain.bodies, [], []
    for seed in seeds:
        start = time.process_time()
        trained.append(train_bodies(cases, config, seed, kind))
        seconds.append(time.process_time() - start)
    widths = {name: body.width for name, body in trained[0].items()}
    training = [cases["case_i"], cases["case_iv"]]
    own = [b.training_errors(cases) for b in trained]
    rows = []
    floors = {where: pod_floor(training, [frame], widths) for where, frame in held.items()}
    linear = {where: pod_floor(training, [frame], widths, "linear") for where, frame in held.items()}
    found = {where: [b.errors([frame]) for b in trained] for where, frame in held.items()}
    found_linear = {where: [b.errors([frame], "linear") for b in trained] for where, frame in held.items()}
    for column in own[0]:
        row: list[object] = [column, float(np.mean([e[column] for e in own])), BODY_ERRORS[PRINTED_AS[column]][0]]
        for where in held:
            error = float(np.mean([e[column] for e in found[where]]))
            ratios = [e[column] / floors[where][column] for e in found[where]]
            ratios += [e[column] / linear[where][column] for e in found_linear[where]]
            row += [error, floors[where][column], float(np.max(ratios))]
        rows.append(row)
    header = ["state", "train", "paper train"]
    for where in held:
        header += [where, "POD floor", "ratio"]
    settings = config.paper if kind == "paper" else config.conditioned
    table(
        f"Bodies, kind {kind}, relative L2 [%], {len(seeds)} seeds, {settings.epochs} epochs, "
        f"{np.mean(seconds):.1f} s each (ratio: worst seed, states and linear outputs)",
        header,
        rows,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--seeds", type=int, default=1, help="independent trainings (the paper: 6)")
    parser.add_argument("--noise", type=float, default=0.0, help="label noise of the operators, of the mean label")
    parser.add_argument("--case-v", action="store_true", help="score Case-V too")
    parser.add_argument("--parts", nargs="+", default=["operators", "conditioned", "paper"],
                        choices=["operators", "conditioned", "paper"])  # fmt: skip
    parser.add_argument("--data", type=Path, help="folder to keep the simulated recordings in")
    args = parser.parse_args()
    torch.set_num_threads(1)
    params = load_params(profile=args.profile)
    cases = {name: recording(name, params, args.data) for name in CASES}
    held = {f"val_{seed}": recording(f"val_{seed}", params, args.data) for seed in VALIDATION_SEEDS}
    if args.case_v:
        held["case_v"] = recording("case_v", params, args.data)
    seeds = range(args.seeds)
    for part in args.parts:
        if part == "operators":
            operators(params, seeds, args.noise, cases, held)
        else:
            bodies(params, part, seeds, cases, held)


if __name__ == "__main__":
    main()
