"""Onsets, drifts and laws of time count from the recording's first row, whatever is left out before and between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import single
from dieseltwin.discovery.verdict.findings import since_start
from dieseltwin.discovery.verdict.implied import implied_frame
from dieseltwin.engine import EngineParameters, we2011
from dieseltwin.engine.terms import Term
from dieseltwin.recordings.liveliest import liveliest
from dieseltwin.recordings.reader import Recording, recording

LEAK, CLOGGING = Term(effect="boost_leak", magnitude=2e-5, onset_s=170.0), Term(effect="egr_clogging", magnitude=5e-4)


def stopped(first_s: float = 1000.0) -> Recording:
    """Four minutes at 5 Hz that begin and go on with the engine standing still for half a minute and for a minute."""
    t = np.arange(1200) / 5.0
    noise = np.random.default_rng(0).standard_normal((5, t.size))
    still = (t < 30.0) | ((t >= 90.0) & (t < 150.0))
    return recording({
        "time_s": first_s + t, "n_e_rpm": np.where(still, 0.0, 1200.0 + 200.0 * np.sin(t / 7.0)),
        "u_delta_mg": 100.0 + 30.0 * np.sin(t / 5.0), "u_egr_pct": 40.0 + 10.0 * np.sin(t / 9.0),
        "u_vgt_pct": 50.0 + 10.0 * np.sin(t / 11.0), "p_im_pa": 2.0e5 + 500.0 * noise[0],
        "p_em_pa": 2.2e5 + 500.0 * noise[1], "omega_t_rad_s": 7000.0 + 20.0 * noise[2],
        "w_egr_kg_s": 0.03 + 0.001 * noise[3], "t_em_k": 800.0 + 5.0 * noise[4],
    })  # fmt: skip


def engine(*terms: Term) -> EngineParameters:
    return we2011.PARAMETERS.replace(terms=terms)


def test_a_term_of_the_engine_begins_where_identify_lets_it_begin() -> None:
    source = stopped()
    twin = EngineTwin(source, engine(LEAK))
    leak = twin.combined(single([e.value for e in twin.parameters], twin.first_local()))[1]["boost_leak"]
    begins_s = twin.recording_time_s[np.flatnonzero(leak)[0]]
    segment = source.segments(80.0)[-1]
    factor = LEAK.factor(segment.columns["time_s"], segment.inputs.recording_start_s, {})
    assert begins_s == segment.columns["time_s"][np.flatnonzero(factor)[0]] == 1170.0
    assert since_start(twin, float(twin.time_s[np.flatnonzero(leak)[0]])) == 170.0


def test_what_is_implied_has_the_leak_since_its_onset() -> None:
    table = implied_frame(stopped(), engine(LEAK))
    leaks = table["w_leak_im_kg_s"].to_numpy() > 0.0
    assert np.array_equal(leaks, table["time_s"].to_numpy() >= 1170.0)


def test_a_valve_goes_on_clogging_while_the_engine_stands_still() -> None:
    source = stopped()
    twin = EngineTwin(source, engine(CLOGGING))
    lane = single([e.value for e in twin.parameters], twin.first_local())
    known, (magnitudes, schedules) = twin.simulate(lane), twin.combined(lane)
    assert magnitudes["egr_clogging"] * schedules["egr_clogging"] == pytest.approx(
        CLOGGING.magnitude * (twin.recording_time_s - 1000.0)
    )
    tried = EngineTwin(source, engine())
    lane = replace(lane, magnitudes={"egr_clogging": np.array([CLOGGING.magnitude])})
    assert tried.simulate(lane) == pytest.approx(known, rel=1e-12, nan_ok=True)
    assert tried.variables(lane)["t"] == pytest.approx(twin.recording_time_s - 1000.0)


def test_stretches_of_a_long_recording_know_when_it_began() -> None:
    source = stopped()
    part = liveliest(replace(source, cut_from_s=None), 1.0)
    assert part.time_s.size < source.time_s.size
    assert part.start_s == source.start_s == EngineTwin(part, engine()).start_s == 1000.0
    assert liveliest(part, 0.5).start_s == 1000.0
