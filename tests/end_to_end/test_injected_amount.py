"""An injector that gives the same amount too little at every stroke: no share of it, and no less than nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.laws.features import Feature, generic_features
from dieseltwin.discovery.laws.search import law_text
from dieseltwin.discovery.likelihood.fit import first_fit
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.engine.terms import LawTerm
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.reader import Recording, recording

AMOUNT = -4.0  # mg/cycle
NOISE = (0.001, 0.001, 0.00075, 0.005, 0.001, 0.0025)  # of each channel's mean


def _recorded(amount: float) -> Recording:
    """Five minutes; the recorder sees what was commanded."""
    rng = np.random.default_rng(31)
    driving = draw_driving("random", 300.0, we2011.PARAMETERS.model_dump(), np.random.default_rng(30))
    told = pd.DataFrame(driving.columns())
    real = told.assign(u_delta_mg=np.maximum(told["u_delta_mg"] + amount, 0.0))
    table = pd.concat([told, dt.simulate(real).table()[list(MEASURED)]], axis=1)
    for column, share in zip(MEASURED, NOISE, strict=True):
        table[column] += share * table[column].mean() * rng.standard_normal(len(table))
    return recording({name: table[name].to_numpy() for name in table})


def _amounts(twin: EngineTwin) -> list[Feature]:
    features = generic_features(twin, first_fit(twin))
    return [feature for feature in features if feature.form is not None and feature.form.amount]


def test_an_amount_is_asked_for_where_it_is_no_share() -> None:
    """Of injected mass, which overrun takes to nearly nothing; of no temperature, which stays within a third."""
    twin = EngineTwin(_recorded(0.0), we2011.PARAMETERS, MEASURED)
    (feature,) = _amounts(twin)
    assert feature.form is not None and feature.site == "fuel_injection"
    assert law_text(twin, feature.form, AMOUNT, std=0.1) == "added to u_delta: -4 ± 0.1 mg/cycle"
    fuel = np.array([0.0, 2.0, 100.0])
    np.testing.assert_allclose(feature.form.value({"u_delta": fuel}) * fuel, [0.0, 1.0, 1.0])
    cut = _recorded(0.0)
    idle = cut.columns["u_delta_mg"] < np.quantile(cut.columns["u_delta_mg"], 0.1)
    columns = Columns({**cut.columns, "u_delta_mg": np.where(idle, 0.0, cut.columns["u_delta_mg"])})
    assert len(_amounts(EngineTwin(replace(cut, columns=columns), we2011.PARAMETERS, MEASURED))) == 1


def test_no_less_than_nothing_is_injected() -> None:
    term = LawTerm(point="u_delta", coefficient=AMOUNT, unit="-", factors=(("u_delta", 1.0, -1.0),))
    time_s = np.arange(0.0, 20.0, 0.2)
    driven = {"time_s": time_s, "n_e_rpm": 1200.0, "u_egr_pct": 10.0, "u_vgt_pct": 60.0}
    tables = []
    for load, overrun, engine in ((80.0, 2.0, dt.engine("we2011", terms=[term])), (76.0, 0.0, we2011.PARAMETERS)):
        fuel = np.where(time_s < 12.0, load, overrun)
        tables.append(dt.simulate(pd.DataFrame({**driven, "u_delta_mg": fuel}), engine).table())
    settled = (time_s < 11.0) | (time_s > 13.0)  # between them fuel falls along another line
    np.testing.assert_allclose(*(table.loc[settled, list(MEASURED)] for table in tables), rtol=0.02)


@pytest.mark.thorough
def test_it_is_a_law_of_the_injection() -> None:
    found = discover(_recorded(AMOUNT), we2011.PARAMETERS)
    (effect,), location = found.document.effects, found.document.location
    assert effect.name == NONE_OF_THESE and location is not None and location.site == "fuel_injection"
    (term,) = found.engine.terms
    assert isinstance(term, LawTerm) and term.factors == (("u_delta", 1.0, -1.0),)
    assert term.coefficient == pytest.approx(AMOUNT, abs=0.6)
