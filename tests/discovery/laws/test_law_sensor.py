"""Faults of sensors that have no name are found as laws of readings, and go into the engine file as terms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from dieseltwin.discovery.laws.features import generic_features, score_features
from dieseltwin.discovery.laws.grammar import Factor, Form
from dieseltwin.discovery.laws.ranking import Ranked, simpler
from dieseltwin.discovery.laws.reading_twin import ReadingFault
from dieseltwin.discovery.laws.search import Law, _simplest_first
from dieseltwin.discovery.laws.sensor import FaultFit, best_law, faults_of, sensor_fault
from dieseltwin.discovery.laws.shapes import lagged, orifice
from dieseltwin.discovery.laws.terms import law_terms_of
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.twins.interface import LawScope, Twin
from dieseltwin.engine.binding import bind
from dieseltwin.engine.quantities import ADDED_AT, POINTS
from dieseltwin.engine.terms import ActuatorTerm, LawTerm, SensorTerm, Term
from dieseltwin.recordings.noise import estimate_noise
from tests.discovery.toy import Toy, null_fit


def _null(toy: Toy) -> Linearisation:
    twin = cast(Twin, toy)
    return null_fit(twin, Whitening.of(twin.measured, estimate_noise(twin.measured), twin.starts))


@pytest.mark.parametrize(("kind", "size"), [("gain", -0.12), ("offset", 0.25)])
def test_gain_and_offset_are_refitted(kind: str, size: float) -> None:
    toy = Toy().record()
    toy.measured[:, 0] = toy.measured[:, 0] * (1.0 + size) if kind == "gain" else toy.measured[:, 0] + size
    at = _null(toy)
    structure = score_features(at, generic_features(cast(Twin, toy), at.fit))
    fault = sensor_fault(cast(Twin, toy), at, faults_of(structure, toy.channels))
    assert fault is not None
    law = fault.law()
    assert law.site == "sensor:x" and law.faults[0].kind == kind
    assert law.faults[0].size == pytest.approx(size, abs=max(4.0 * law.std, 0.01)) and 0.0 < law.std < 0.02
    assert law.parameters[0] == pytest.approx(1.1, rel=0.01)
    assert law.gain > 0.5 * at.fit.objective
    twin, fit = law.on(cast(Twin, toy))
    left = toy.measured - twin.simulate(fit.lanes())[0]
    assert np.abs(left.mean(axis=0)).max() < 0.02
    if kind == "offset":  # the toy can't tell a gain of x from one of u together with its own
        best = best_law(cast(Twin, toy), at, structure)
        assert best is not None and best.text == law.text


def test_a_lag_is_found_where_a_sensor_may_lag() -> None:
    toy = Toy().record()
    toy.measured[:, 1] = lagged(toy.measured[:, 1], toy.time_s, 0.8)
    at = _null(toy)

    def found() -> FaultFit | None:
        structure = score_features(at, generic_features(cast(Twin, toy), at.fit))
        return sensor_fault(cast(Twin, toy), at, faults_of(structure, toy.channels))

    without = found()
    assert without is None or without.faults[0].kind != "lag"
    toy.law_scope = LawScope(lagging_sensors=("y",))  # type: ignore[attr-defined]
    fault = found()
    assert fault is not None and (without is None or fault.gain > 2.0 * without.gain)
    law = fault.law()
    assert law.faults[0].kind == "lag"
    assert law.faults[0].size == pytest.approx(0.8, abs=0.1)


def test_a_hundredth_of_a_lag_is_none() -> None:
    """A healthy engine had "reading 0.015 s behind": three quarters of a per cent of what a lag of 2 s changes."""

    def gains(reading: np.ndarray) -> dict[str, float]:
        toy.measured[:, 1] = reading
        at = _null(toy)
        found = score_features(at, generic_features(cast(Twin, toy), at.fit))
        return {item.feature.text: item.gain for item in found if item.feature.fault == "lag"}

    toy = Toy().record()
    toy.law_scope = LawScope(lagging_sensors=("y",))  # type: ignore[attr-defined]
    true = toy.measured[:, 1].copy()
    lag = lagged(true, toy.time_s, 2.0) - true
    assert max(gains(true + lag).values()) > 100.0
    assert max(gains(true + 0.02 * lag).values(), default=0.0) < 10.0


def test_span_and_zero_of_a_sensor_are_found_together() -> None:
    toy = Toy().record()
    toy.measured[:, 1] = toy.measured[:, 1] * 1.15 - 0.2
    at = _null(toy)
    structure = score_features(at, generic_features(cast(Twin, toy), at.fit))
    fault = sensor_fault(cast(Twin, toy), at, [f for f in faults_of(structure, toy.channels) if f.channel == "y"])
    assert fault is not None
    law = fault.law()
    sizes = {found.kind: (found.size, found.std) for found in law.faults}
    for kind, truth in (("gain", 0.15), ("offset", -0.2)):
        size, std = sizes[kind]
        assert std is not None and size == pytest.approx(truth, abs=4.0 * std) and std < 0.05
    assert "reading of y (1 + g)" in law.text and "reading of y +" in law.text
    both = _terms(faults=(ReadingFault("p_im_pa", "gain", 0.1, 0.01), ReadingFault("p_im_pa", "offset", 500.0, 20.0)))
    assert [term.fault for term in both if isinstance(term, SensorTerm)] == ["gain", "offset"]


def test_nothing_on_a_healthy_recording() -> None:
    toy = Toy().record()
    at = _null(toy)
    structure = score_features(at, generic_features(cast(Twin, toy), at.fit))
    assert sensor_fault(cast(Twin, toy), at, faults_of(structure, toy.channels)) is None
    assert faults_of([s for s in structure if s.feature.channel is None], toy.channels) == []


def _terms(*laws: Placed, faults: tuple[ReadingFault, ...] = ()) -> tuple[object, ...]:
    points = [SimpleNamespace(name=name, unit=ADDED_AT.get(name, "-")) for name in POINTS]
    law = SimpleNamespace(placed=laws, faults=faults, text="", std=0.1)
    return law_terms_of(cast(Law, law), points)


def test_laws_become_terms_of_the_engine_file() -> None:
    fault = ReadingFault("p_im_pa", "offset", 500.0, 20.0)
    assert _terms(faults=(fault,)) == (SensorTerm(sensor="p_im_pa", fault="offset", magnitude=500.0, std=20.0),)
    late = Placed(Form("u_vgt", (Factor("dead_time", ("u_vgt",), (1.0,), 0.3, ("%",)),), 1.0), 1.0)
    assert _terms(late) == (ActuatorTerm(actuator="vgt", fault="dead_time", magnitude=0.3),)
    slow = Placed(Form("T_em", (Factor("lag", ("T_em",), (0.0,), 0.4, ("K",)),), 1.0), 1.0)
    assert _terms(slow) == (Term(effect="exhaust_thermal_inertia", magnitude=0.4),)
    wall = Placed(Form("W_t", (Factor("excess", ("p_em",), (1e5,), 2e5, ("Pa",)),)), 0.1)
    assert _terms(wall) == ()


def test_written_laws_have_the_value_of_the_form() -> None:
    rng = np.random.default_rng(0)
    at = {
        "p_im": rng.uniform(0.9e5, 3e5, 50), "p_em": rng.uniform(0.9e5, 3e5, 50), "T_em": rng.uniform(400, 900, 50),
        "p_amb": np.full(50, 1e5), "W_c": rng.uniform(0.05, 0.4, 50), "W_egr": rng.uniform(0.01, 0.1, 50),
        "Pi_e": rng.uniform(0.8, 1.5, 50),
    }  # fmt: skip
    forms = (
        Form("exhaust_balance", (Factor("orifice", ("p_em", "p_amb", "T_em"), (2e5, 1.0, 600.0), 1.0, ("Pa",) * 3),)),
        Form("exhaust_balance", (Factor("orifice", ("p_em", "p_im"), (2e5, 1.0), 1.0, ("Pa", "Pa")),)),
        Form("eta_vol", (Factor("above_one", ("Pi_e",), (1.0,), 1.0, ("-",)),)),
        Form("eta_vol", (Factor("difference", ("p_em", "p_im"), (3e4, 3e4), 0.5, ("Pa", "Pa")),)),
        Form("T_im", (
            Factor("share", ("W_egr", "W_c"), (1.0, 1.0), 1.0, ("kg/s",) * 2),
            Factor("head", ("p_em", "p_im"), (1.0, 1.0), 1.0, ("Pa",) * 2), Factor("power", ("T_em",), (600.0,), 2.0),
        )),
    )  # fmt: skip
    for form in forms:
        (term,) = _terms(Placed(form, 0.3))
        assert isinstance(term, LawTerm)
        np.testing.assert_allclose(term.signal(at), 0.3 * form.value(at), rtol=1e-5, atol=1e-7)
    assert np.abs(term.signal(at)).max() > 0.0 and orifice(2e5, 1e5) == pytest.approx(1.0)


def test_nozzles_of_tensors() -> None:
    torch = pytest.importorskip("torch")
    nozzle = bind("torch").nozzle_flow_factor
    term = LawTerm(point="W_t", coefficient=1.0, unit="-", groups=[  # type: ignore[arg-type]
        {"kind": "orifice", "variables": ("p_em", "p_im")}])  # fmt: skip
    p_em = torch.tensor([1e5, 1.2e5, 1.5e5, 4e5], dtype=torch.float64, requires_grad=True)
    value = term.signal({"p_em": p_em, "p_im": torch.full((4,), 1.2e5, dtype=torch.float64)}, torch.pow, nozzle)
    value.sum().backward()
    exact = orifice(p_em.detach().numpy(), 1.2e5)
    np.testing.assert_allclose(value.detach().numpy(), exact, atol=1e-6)
    assert torch.isfinite(p_em.grad).all() and p_em.grad[0] > 0


def test_of_laws_that_cannot_be_told_apart_the_simplest_is_first() -> None:
    def refit(score: float, *forms: Form) -> SimpleNamespace:
        laws = [Placed(form, 1.0) for form in forms]
        return SimpleNamespace(score=score, gain=score + 30.0, twin=SimpleNamespace(laws=laws))

    power = Factor("power", ("Pi_c",), (1.0,), 0.5, ("-",))
    bent, plain = refit(90.0, Form("W_c", (power,)), Form("W_c")), refit(84.0, Form("W_c"))
    weak = refit(77.0, Form("eta_c"))
    assert _simplest_first([bent, plain, weak]) == [plain, bent, weak]  # type: ignore[comparison-overlap, list-item]
    assert _simplest_first([bent, weak])[0] is bent  # type: ignore[list-item]
    # where much is gained, forms also follow the errors of maps
    bent, plain = refit(7000.0, Form("W_c", (power,)), Form("W_c")), refit(6830.0, Form("W_c"))
    assert _simplest_first([bent, plain])[0] is plain  # type: ignore[list-item]
    assert _simplest_first([bent, refit(6750.0, Form("W_c"))])[0] is bent  # type: ignore[list-item]


def test_the_last_fit_is_about_the_fault_itself() -> None:
    toy = Toy().record()
    toy.measured[:, 0] *= 1.2
    at = _null(toy)
    mean = np.zeros_like(toy.measured)
    mean[:, 0] = 0.005 * at.simulated[:, 0].mean()
    at = null_fit(cast(Twin, toy), at.whitening, at.fit.parameters, mean[None])
    structure = score_features(at, generic_features(cast(Twin, toy), at.fit))
    asked: list[np.ndarray] = []

    def tolerances(here: Linearisation) -> np.ndarray:
        asked.append(here.simulated)
        own = np.zeros_like(here.simulated)
        own[:, 0] = 0.005 * here.simulated[:, 0].mean()
        return own[None]

    fault = sensor_fault(cast(Twin, toy), at, faults_of(structure, toy.channels))
    assert fault is not None
    law = fault.law(tolerances)
    assert asked  # asked about the reading with its fault, not about the one without
    assert asked[0][:, 0].mean() == pytest.approx(np.nanmean(toy.measured[:, 0]), rel=0.05)
    assert law.faults[0].size == pytest.approx(0.2, abs=max(4.0 * law.std, 0.02))


def test_simpler_candidates_near_the_best_are_refitted_too() -> None:
    def of(index: int, score: float, *forms: Form) -> Ranked:
        return Ranked(index, "", tuple(Placed(form, 1.0) for form in forms), score, 0.0)

    n_e = ("n_e",), (1000.0,)
    plain, line, cube = (Form("eta_vol", f) for f in ((), (Factor("power", *n_e),), (Factor("power", *n_e, 3.0),)))
    crooked, straight = of(0, 100.0, line, cube), of(0, 90.0, plain, line)
    far, elsewhere = of(0, 60.0, plain), of(1, 95.0, plain)
    assert crooked.complexity > straight.complexity > far.complexity
    assert simpler([crooked, elsewhere, straight, far], crooked) == [straight]
    assert simpler([crooked, elsewhere, straight, far], straight) == []
