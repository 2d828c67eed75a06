"""Steps of the flow ``simulate``: driving sets, laboratory recordings, field recordings.

Every step takes only the sections of params.yaml that it reads, so that a change elsewhere doesn't run it again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tasks.run_context import Progress, step

# What the pictures of the sets show.
_RESPONSE_COLUMNS = (
    "time_s",
    "n_e_rpm",
    "u_delta_mg",
    "u_egr_pct",
    "u_vgt_pct",
    "p_im_pa",
    "p_em_pa",
    "omega_t_rad_s",
    "lambda",
    "egr_fraction",
    "torque_nm",
)


def sections_read(**sections: dict[str, Any]) -> Any:
    """The sections as their validated models, under the names that ``Params`` gives them."""
    from types import SimpleNamespace

    from dieseltwin.settings.params import DrivingConfig, EngineConfig, NoiseConfig

    models = {"driving": DrivingConfig, "engine": EngineConfig, "noise": NoiseConfig}
    return SimpleNamespace(**{name: models[name](**section) for name, section in sections.items()})


@step("driving-sets", "driving: Set-I to Set-IV", expected_s=30.0)
def driving_sets(out: Path, progress: Progress, *, driving: dict[str, Any], engine: dict[str, Any]) -> None:
    """``set_i.parquet`` ...: the inputs of every set; ``response/``: what the engine did while they were made."""
    from dieseltwin.paper.datasets import drive_set, laboratory_parameters
    from dieseltwin.recordings.reader import write_recording

    settings = sections_read(driving=driving, engine=engine)
    durations = {name: config.duration_s for name, config in settings.driving.sets.items()}
    (out / "response").mkdir()
    done = 0.0
    for name, duration_s in durations.items():
        driven = drive_set(name, settings.driving, laboratory_parameters(settings.engine))
        write_recording(driven.inputs, out / f"{name}.parquet")
        write_recording(driven.response[list(_RESPONSE_COLUMNS)], out / "response" / f"{name}.parquet")
        done += duration_s
        progress(done, sum(durations.values()))


@step("recordings", "recordings: Cases I to VII", expected_s=20.0)
def case_recordings(
    out: Path, progress: Progress, *, sets: Path, driving: dict[str, Any], engine: dict[str, Any], noise: dict[str, Any]
) -> None:
    """``lab/case_*.parquet`` and, for the field engine, ``field/case_v_clean.parquet`` (with truth), ``..._noisy``."""
    import pandas as pd

    from dieseltwin.paper.datasets import HEALTH, add_noise, case_parameters, make_case
    from dieseltwin.recordings.reader import write_recording

    settings = sections_read(driving=driving, engine=engine, noise=noise)
    for folder in ("lab", "field"):
        (out / folder).mkdir()
    for done, (name, case) in enumerate(settings.driving.cases.items(), start=1):
        clean = make_case(name, settings, pd.read_parquet(sets / f"{case.set}.parquet"))
        if case.parameters == "lab":
            write_recording(clean, out / "lab" / f"{name}.parquet")
        else:
            write_recording(add_noise(clean, settings.noise), out / "field" / f"{name}_noisy.parquet")
            parameters = case_parameters(name, settings.driving, settings.engine)
            truth = clean.assign(**{parameter: getattr(parameters, parameter) for parameter in HEALTH})
            write_recording(truth, out / "field" / f"{name}_clean.parquet")
        progress(done, len(settings.driving.cases))
