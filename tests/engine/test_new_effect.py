"""A new effect is one file: it is listed, simulated, a candidate, drawn and told, and nothing else is edited."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import bind, constants, we2011
from dieseltwin.engine.binding import hook_source
from dieseltwin.engine.effect import Effect, Entry
from dieseltwin.engine.effects import EFFECTS, STATE_EFFECTS, Magnitudes
from dieseltwin.engine.effects.intake_heat_pickup import T_WALL
from dieseltwin.engine.hooks import at_T_im
from dieseltwin.engine.quantities import Gas, OperatingPoint, Signals
from dieseltwin.errors import DieselTwinError
from tests.engine.grown import copied, differences, write_effect

PROOF = """
import json
from dieseltwin.discovery.twins.diesel_points import hypotheses_of
from dieseltwin.discovery.verdict.document import FoundEffect
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.report.discovery_words import effect_words

h = hypotheses_of(MEASURED)["swirl_loss"]
found = FoundEffect(name="swirl_loss", probability=0.9, law=h.law, magnitude=0.05, std=0.01, unit=h.unit)
print(json.dumps({"candidate": h.tolerance, "told": effect_words(found)}))
"""


def test_one_file_is_listed_a_candidate_and_told(run_grown: Callable[..., str]) -> None:
    lines = run_grown("-m", "dieseltwin", "effects").splitlines()
    assert any(line.startswith("swirl_loss ") and "eta_vol (1 - k n_e/2000 rpm)" in line for line in lines)
    proof = json.loads(run_grown("-c", PROOF))
    assert proof["candidate"] == 0.01 and "a loss by swirl of 5.0 ± 1.0 % at 2000 rpm" in proof["told"]


def test_one_file_is_simulated(grown: Path, run_grown: Callable[..., str], trace: pd.DataFrame) -> None:
    columns = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s"]
    trace[columns].iloc[:60].to_csv(grown / "in.csv", index=False)
    simulate = ("-m", "dieseltwin", "simulate", "in.csv", "--out", "out.csv")
    run_grown(*simulate, "--effect", "swirl_loss=0.2")
    out = pd.read_csv(grown / "out.csv")
    c = constants(we2011.PARAMETERS)
    published = bind("numpy").eta_vol(out["p_im_pa"], out["n_e_rpm"], c)
    np.testing.assert_allclose(out["eta_vol"], published * (1.0 - 0.2 * out["n_e_rpm"] / 2000.0), rtol=1e-6)


def test_the_patch_is_one_file(tmp_path: Path, project_root: Path) -> None:
    library = copied(project_root, tmp_path)
    write_effect(library)
    assert list(differences(project_root / "dieseltwin", library)) == ["engine/effects/swirl_loss.py"]


def test_intake_heat_pickup_stands_in_its_file_and_in_the_plant_alone(project_root: Path) -> None:
    library = project_root / "dieseltwin"
    named = {p.relative_to(library).as_posix() for p in library.rglob("*.py") if "intake_heat_pickup" in p.read_text()}
    assert named == {"engine/effects/intake_heat_pickup.py", "challenge/plant_effects.py"}


def test_intake_heat_pickup_is_the_heat_of_the_walls() -> None:
    """The charge's enthalpy rises by k (T_wall - T_im) of the charge as it comes."""
    model, c, k = bind("numpy"), constants(we2011.PARAMETERS), 15.0
    x = OperatingPoint(1.4e5, 1.7e5, 5000.0, 0.03, 330.0, np.array([700.0, 1500.0]), 80.0, 30.0, 45.0)
    none = Magnitudes(*([0.0] * len(STATE_EFFECTS)))
    quiet = Signals(*([0.0] * len(Signals._fields)))
    q = model.quantities_extended(x, Gas(700.0, 1.0, 0.0), none._replace(intake_heat_pickup=k), quiet, c)
    np.testing.assert_allclose(q.W_ei * c.c_pa * (q.T_im - c.T_im), k * (T_WALL - c.T_im), rtol=1e-12)
    assert q.T_im[0] > q.T_im[1] > c.T_im


def test_a_law_that_names_what_is_not_there_is_refused() -> None:
    wrong = Effect(
        "wrong", "intake_temperature", Entry("quantity", "T_im"), "T_im + k W_t", "k", "-", 0.1, (0.0, 1.0), "{m}", "-",
        change=lambda T_im, k, W_t: T_im + k * W_t,
    )  # fmt: skip
    with pytest.raises(DieselTwinError, match="W_t"):
        hook_source(at_T_im, [wrong])


def test_names_are_the_modules() -> None:
    assert list(EFFECTS) == sorted(EFFECTS) and all(name == effect.name for name, effect in EFFECTS.items())
