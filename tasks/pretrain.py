"""Steps of the flow ``pretrain``: labels at a fine rate, empirical maps, actuator operators, multi-head bodies.

Each writes the trained file and ``errors.json`` (relative L2 errors in per cent, by output), and the training curves
where it has them. Those that the evaluation repeats write their part of ``pretrain`` in params.yaml too: repeated is
what was done, whichever profile trained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tasks.run_context import Progress, step
from tasks.store import Artifact

ERRORS = "errors.json"
CURVES = "curves.parquet"
SETTINGS = "settings.json"

MAP_KINDS = ("paper", "improved")
BODY_KINDS = ("paper", "conditioned")

# The maps' training cases; another one and the training says that it is missing.
_FINE_CASES = ("case_i", "case_ii", "case_iii", "case_iv")

# What the maps' arguments and the label of eta_tm need: 300 MB of recordings are 100 MB then.
_FINE_COLUMNS = (
    "time_s",
    "n_e_rpm",
    "p_im_pa",
    "p_em_pa",
    "omega_t_rad_s",
    "t_em_k",
    "w_c_kg_s",
    "u_egr1_pct",
    "u_egr2_pct",
    "u_vgt_act_pct",
    "eta_tm",
    "p_amb_pa",
    "t_amb_k",
)


def _cases(folder: Path) -> dict[str, Any]:
    import pandas as pd

    return {path.stem: pd.read_parquet(path) for path in sorted(folder.glob("*.parquet"))}


def _shares(progress: Callable[[float, float], None], parts: int) -> Callable[[str, float], None]:
    """The library tells a part's name and its share done; all parts together are the step."""
    seen: dict[str, float] = {}

    def tell(part: str, share: float) -> None:
        seen[part] = share
        progress(sum(seen.values()), parts)

    return tell


def _write_json(path: Path, content: Any) -> None:
    import json

    path.write_text(json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")


@step("eta-tm-labels", "labels of eta_tm, 40 Hz", expected_s=15.0)
def eta_tm_labels(
    out: Path, progress: Progress, *, sets: Path, driving: dict[str, Any], engine: dict[str, Any]
) -> None:
    """The training cases of the maps, sampled finer, with the columns that the maps need."""
    import pandas as pd

    from dieseltwin.paper.datasets import make_case
    from dieseltwin.recordings.reader import write_recording
    from tasks.simulate import sections_read

    settings = sections_read(driving=driving, engine=engine)
    for done, name in enumerate(_FINE_CASES, start=1):
        inputs = pd.read_parquet(sets / f"{settings.driving.cases[name].set}.parquet")
        frame = make_case(name, settings, inputs, sample_s=settings.driving.sample_eta_tm_s)
        write_recording(frame[list(_FINE_COLUMNS)], out / f"{name}.parquet")
        progress(done, len(_FINE_CASES))


@step("maps", "empirical maps", expected_s=40.0)
def maps(
    out: Path,
    progress: Progress,
    *,
    lab: Path,
    fine: Path,
    field: Path,
    kind: str,
    config: dict[str, Any],
    engine: dict[str, Any],
    label_noise_rel: float,
    seed: int,
) -> None:
    """``maps.pt``, one kind of the six maps."""
    from dieseltwin.paper.datasets import laboratory_parameters
    from dieseltwin.settings.maps import MapsConfig
    from dieseltwin.settings.params import EngineConfig
    from dieseltwin.surrogates.empirical_training import MapData, train_maps

    cases, unseen = _cases(lab), _cases(field)
    trained = train_maps(
        MapData(
            cases,
            finer=_cases(fine),
            held_out={name: frame for name, frame in unseen.items() if name.endswith("_clean")},
            engine=laboratory_parameters(EngineConfig(**engine)),
        ),
        MapsConfig(**config),
        seed,
        kind,  # type: ignore[arg-type]
        label_noise_rel=label_noise_rel,
        progress=lambda part, share: progress(share, 1.0),
    )
    trained.save(out / "maps.pt")
    table = trained.errors()
    test = table[~table["recording"].isin(cases)]
    rows = test.set_index("map")["l2_rel"]
    _write_json(out / ERRORS, {name: {"test": 100.0 * float(value)} for name, value in rows.items()})
    table.to_csv(out / "errors.csv", index=False)


@step("operators", "actuator operators (DeepONets)", expected_s=110.0)
def operators(
    out: Path,
    progress: Progress,
    *,
    lab: Path,
    field: Path,
    config: dict[str, Any],
    engine: dict[str, Any],
    seed: int,
) -> None:
    """``operators.pt``."""
    import pandas as pd

    from dieseltwin.paper.datasets import laboratory_parameters
    from dieseltwin.settings.params import EngineConfig, OperatorsConfig
    from dieseltwin.surrogates.operators import OPERATORS, train_operators

    cases = _cases(lab)
    parameters = laboratory_parameters(EngineConfig(**engine))
    trained = train_operators(
        cases, OperatorsConfig(**config), seed, parameters, progress=_shares(progress, len(OPERATORS))
    )
    trained.save(out / "operators.pt")
    test = trained.errors(pd.read_parquet(field / "case_v_clean.parquet"))
    train = trained.training_errors(cases)
    errors = {_symbol(label): {"train": train[label], "test": test[label]} for label in test}
    _write_json(out / ERRORS, errors)
    _write_json(out / SETTINGS, config)
    curves = [
        pd.DataFrame(getattr(trained, name).curve, columns=["epoch", "value"]).assign(quantity=f"loss_{name}")
        for name in OPERATORS
    ]
    pd.concat(curves, ignore_index=True).to_parquet(out / CURVES, index=False)


_SYMBOLS = {
    "u_egr1_pct": "u_egr1",
    "u_egr2_pct": "u_egr2",
    "u_vgt_act_pct": "u_vgt",
    "p_im_pa": "p_im",
    "p_em_pa": "p_em",
    "omega_t_rad_s": "omega_t",
    "x_r": "x_r",
    "t_1_k": "T_1",
}


def _symbol(column: str) -> str:
    """The paper's symbol, as the report and the tracker show it."""
    return _SYMBOLS[column]


@step("bodies", "multi-head bodies", expected_s=60.0)
def bodies(
    out: Path,
    progress: Progress,
    *,
    lab: Path,
    kind: str,
    config: dict[str, Any],
    seed: int,
) -> None:
    """``bodies.pt``, one kind of the four bodies; held out: the laboratory recordings with other driving."""
    import numpy as np
    import pandas as pd

    from dieseltwin.settings.params import BodiesConfig
    from dieseltwin.surrogates.bodies import BODIES, TRAINING_CASES, pod_floor, train_bodies

    cases = _cases(lab)
    trained = train_bodies(
        cases,
        BodiesConfig(**config),
        seed,
        kind,  # type: ignore[arg-type]
        progress=_shares(progress, len(BODIES)),
    )
    trained.save(out / "bodies.pt")
    held_out = [cases[name] for name in ("case_vi", "case_vii")]
    widths = {name: body.width for name, body in trained.items()}
    tables = {
        "train": trained.training_errors(cases),
        "held_out": trained.errors(held_out, "linear"),
        "pod_floor": pod_floor([cases[name] for name in TRAINING_CASES], held_out, widths, "linear"),
    }
    columns = [column for group in BODIES.values() for column in group]
    errors = {_symbol(column): {kind: table[column] for kind, table in tables.items()} for column in columns}
    _write_json(out / ERRORS, errors)
    _write_json(out / SETTINGS, config)
    curves = [
        pd.DataFrame(np.asarray(body.curve), columns=["epoch", "value"]).assign(quantity=f"loss_{name}")
        for name, body in trained.items()
    ]
    pd.concat(curves, ignore_index=True).to_parquet(out / CURVES, index=False)


def files_to_publish(trained: Mapping[str, Artifact]) -> dict[str, Path]:
    """Names in ``models/`` -> files: ``NAME.pt``, and a file of each in ``errors/``, ``curves/`` and ``settings/``."""
    files: dict[str, Path] = {}
    for name, artifact in trained.items():
        kind = name.partition("_")[0]
        files[f"{name}.pt"] = artifact.path / f"{kind}.pt"
        for written in (ERRORS, CURVES, SETTINGS):
            if (artifact.path / written).exists():
                files[_published_as(written, name)] = artifact.path / written
    return files


def _published_as(written: str, name: str) -> str:
    """Where in ``models/`` a file that a step writes stands for one part: errors.json -> errors/NAME.json."""
    return f"{Path(written).stem}/{name}{Path(written).suffix}"


def trained_with(models: Path, name: str) -> dict[str, Any]:
    """``pretrain`` of params.yaml with which one part of ``models/`` was trained: "operators", "bodies_paper"."""
    import json

    settings: dict[str, Any] = json.loads((models / _published_as(SETTINGS, name)).read_text(encoding="utf-8"))
    return settings
