"""A bump of a map over one of its arguments: no name of the catalogue may stand for it, and the law is the bump."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest

from dieseltwin.challenge.routes import draw_driving
from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.twin import LawTwin, Placed
from dieseltwin.discovery.likelihood.fit import fit_fully
from dieseltwin.discovery.search.run import run
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.verdict import told as telling
from dieseltwin.discovery.verdict.explained import disagreement
from dieseltwin.discovery.verdict.told import beside_fine_maps, told
from dieseltwin.engine import Inputs, simulate, we2011
from dieseltwin.engine.terms import LawGroup, LawTerm
from dieseltwin.recordings.reader import recording
from dieseltwin.settings.defaults import default_search

SENSORS = {
    "p_im_pa": 0.03, "p_em_pa": 0.03, "omega_t_rad_s": 0.01, "w_egr_kg_s": 0.05, "t_em_k": 0.03, "w_c_kg_s": 0.03,
}  # fmt: skip
BUMP = LawTerm(
    point="eta_vol", coefficient=0.08, unit="-",
    groups=(LawGroup(kind="bump", variables=("n_e",), reference=100.0, centre=1300.0),),
)  # fmt: skip


def _searched(bump: bool, seed: int = 0) -> Search:
    laboratory = we2011.PARAMETERS
    driving = draw_driving("random", 300.0, laboratory.model_dump(), np.random.default_rng(5))
    engine = laboratory.replace(A_egrmax=1.1 * laboratory.A_egrmax, terms=(BUMP,) if bump else ())
    inputs = Inputs(driving.time_s, driving.n_e_rpm, driving.u_delta_mg, driving.u_egr_pct, driving.u_vgt_pct)
    table = simulate(inputs, engine)
    rng = np.random.default_rng(6)
    noisy = {
        name: table[name] + rng.normal(0.0, share * table[name].mean(), len(table)) for name, share in SENSORS.items()
    }
    columns = {name: table[name].to_numpy() for name in ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")}
    twin = EngineTwin(recording(pd.DataFrame({**columns, **noisy})), laboratory)
    return run(twin, default_search().driving.asked((), seed), laws=False)


@pytest.fixture(scope="module")
def bumped() -> Search:
    return _searched(True)


def test_a_bump_of_a_map_gets_no_name(bumped: Search) -> None:
    strongest: Structure = bumped.everything_unnamed()[0]
    assert bumped.kind == "law"
    assert strongest.feature.site == "cylinder_flow" and "bump(n_e about 1" in strongest.feature.text
    assert strongest.gain > 10.0 * bumped.gain(bumped.singles[0])
    assert bumped.share_explained() == 0.0 and bumped.more_is_missing()


@pytest.fixture(scope="module")
def healthy() -> Search:
    return _searched(False)


def test_a_healthy_machine_has_no_bumps(healthy: Search) -> None:
    assert healthy.kind == "healthy" and not healthy.more_is_missing() and healthy.share_explained() is None
    assert max(item.gain for item in healthy.local) < healthy.settings.local_gain


def test_health_is_told_beside_maps_in_all_detail(healthy: Search) -> None:
    at, count = healthy.null, len(healthy.twin.parameters)
    places = beside_fine_maps(healthy, at)
    assert len(places) in (2, 3)
    std = places[-1].fit.std[:count]
    leading = np.sqrt(np.diag(at.covariance)[:count])
    assert (std >= leading).all() and (std > 1.001 * leading).any()


def test_health_is_the_mean_over_the_places_and_as_uncertain_as_they_differ(
    bumped: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    at, search = bumped.null, replace(bumped, kind="healthy", widening=1.0)
    places = beside_fine_maps(search, at)
    places[-1] = replace(places[-1], fit=replace(places[-1].fit, parameters=1.001 * places[-1].fit.parameters))
    monkeypatch.setattr(telling, "beside_fine_maps", lambda *_: places)
    fit = told(search, at, at.simulated).fit
    said = np.array([place.fit.parameters for place in places])
    assert fit.parameters == pytest.approx(said.mean(axis=0), rel=1e-12)
    apart = said.var(axis=0, ddof=1)
    assert (apart > 0.0).any()
    assert np.diag(fit.covariance) == pytest.approx(np.diag(places[-1].fit.covariance) + apart)
    wider = told(replace(search, widening=4.0), at, at.simulated).fit
    assert wider.covariance - fit.covariance == pytest.approx(3.0 * places[-1].fit.covariance)
    assert told(replace(search, kind="law"), at, at.simulated).fit is at.fit


def test_beside_a_law_health_keeps_its_values_and_is_as_uncertain_as_fine_maps_let_it_be(bumped: Search) -> None:
    null, form = bumped.null, bumped.everything_unnamed()[0].feature.form
    assert form is not None
    twin = LawTwin(bumped.twin, [Placed(form, 0.08)])
    start = replace(null.fit, parameters=np.append(null.fit.parameters, 0.08))
    at = fit_fully(twin, null.whitening, start, null.nuisance_response)
    law = cast(Law, SimpleNamespace(disagreement=None))
    fit = told(replace(bumped, kind="law", law=law), at, at.simulated).fit
    assert (fit.parameters == at.fit.parameters).all()
    assert (fit.std > 0.999 * at.fit.std).all() and (fit.std > 1.1 * at.fit.std).any()


def test_the_law_of_an_engine_file_is_the_bump_itself() -> None:
    at = {"n_e": np.array([1300.0, 1400.0, 1600.0])}
    assert BUMP.signal(at) == pytest.approx(0.08 * np.exp([0.0, -0.5, -4.5]))


# the bump also bends a window in which the turbo goes elsewhere by less than what is left out (`search.bends`)
def test_what_is_left_widens_health_as_far_as_it_is_off(bumped: Search) -> None:
    """Taken for healthy the bump is all in health; the term that is left says by how much."""
    at, count = bumped.null, len(bumped.twin.parameters)
    truth = we2011.PARAMETERS.replace(A_egrmax=1.1 * we2011.PARAMETERS.A_egrmax)
    true = np.array([getattr(truth, parameter.name) for parameter in bumped.twin.parameters])
    off = np.abs(at.fit.parameters[:count] - true)
    std = np.sqrt(np.diag(at.covariance)[:count])
    assert (off / std).max() > 2.5
    apart = disagreement(replace(bumped, kind="single", singles=bumped.singles[:1], left=bumped.local), at)
    covered = (off / np.hypot(std, apart)).max()
    assert covered < 2.5 and covered < 0.5 * (off / std).max()
    nothing_found = replace(bumped, kind="healthy")  # an effect that may be there all the same is all that counts then
    assert disagreement(nothing_found, at).any()
    assert not disagreement(replace(nothing_found, singles=[]), at).any()
