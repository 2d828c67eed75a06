"""Faults in a made-up engine and in real recordings are found, named, sized and dated; healthy ones are left alone."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.petrol.calibrate import fit_maps, pieces
from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.effects import HYPOTHESES, TOUCHES, undo
from dieseltwin.petrol.model import bind
from dieseltwin.petrol.parameters import PetrolParameters, load_petrol, save_petrol
from dieseltwin.petrol.recording import PetrolRecording, read_petrol
from dieseltwin.petrol.search import scan
from tests.petrol.plant import ONSET_S

Recorder = Callable[..., PetrolRecording]
CASES = [
    ({"p_im_Pa": -0.10}, "p_im_gain", -0.10),
    ({"p_ic_Pa": 0.05}, "p_ic_gain", 0.05),
    ({"W_af_kg_s": 0.10}, "w_af_gain", 0.10),
    ({"W_af_kg_s": -0.08}, "w_af_gain", -0.08),
    ({"leak_m2": 1.5e-6}, "intake_leak", 1.5e-6),
    ({"leak_m2": 1.5e-5}, "intake_leak", 1.5e-5),
]


@pytest.mark.parametrize(("fault", "name", "size"), CASES, ids=[f"{n} {s:g}" for _, n, s in CASES])
def test_planted_fault(engine: PetrolParameters, record: Recorder, fault: dict, name: str, size: float) -> None:
    found = discover_petrol(record(2, **fault), engine)
    d = found.document
    assert d.mismatch and d.location is not None
    assert d.effects[0].name == name and d.location.site == HYPOTHESES[name].site
    assert d.effects[0].magnitude == pytest.approx(size, rel=0.15)
    assert d.location.onset_s == pytest.approx(ONSET_S, abs=8.0)
    assert d.fit.held_out_nll_after is not None and d.fit.held_out_nll_before is not None
    assert d.fit.held_out_nll_after < d.fit.held_out_nll_before
    assert name in found.sentence


@pytest.mark.parametrize("seed", [3, 4])
def test_healthy(engine: PetrolParameters, record: Recorder, seed: int) -> None:
    d = discover_petrol(record(seed), engine).document
    assert not d.mismatch and d.effects == () and d.location is None
    assert d.minimum_detectable["p_ic_gain"] < 0.05


@pytest.mark.parametrize("name", list(HYPOTHESES))
def test_nothing_to_undo_changes_nothing(record: Recorder, engine: PetrolParameters, name: str) -> None:
    signals = record(5, 120.0).signals
    bound = bind(engine, signals)
    same = bind(engine, undo(name, 0.0, np.ones(len(signals.time_s)), signals))
    for balance in TOUCHES[name]:
        np.testing.assert_allclose(same.null()[balance].residual, bound.null()[balance].residual, atol=1e-9)


def test_score_of_an_effect_is_largest_near_its_onset(engine: PetrolParameters, record: Recorder) -> None:
    found = scan(bind(engine, record(6, W_af_kg_s=0.1).signals), "w_af_gain")
    assert abs(float(found.onsets_s[int(np.argmax(found.score))]) - ONSET_S) < 30.0


def test_time_shift_changes_nothing(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    first = record(7, 300.0, p_im_Pa=0.1)
    table = pd.read_csv(first.path)
    table["time_s"] += 1000.0
    table.to_csv(tmp_path / "later.csv", index=False)
    before, after = (discover_petrol(r, engine).document for r in (first, read_petrol(tmp_path / "later.csv")))
    assert before.location is not None and after.location is not None
    assert after.location.onset_s == pytest.approx((before.location.onset_s or 0.0) + 1000.0, abs=1.5)
    assert after.effects[0].magnitude == pytest.approx(before.effects[0].magnitude, rel=0.02)


def test_engine_file_round_trip(engine: PetrolParameters, tmp_path: Path) -> None:
    again = load_petrol(save_petrol(engine, tmp_path / "engine.yaml"))
    assert again.cylinder is not None and engine.cylinder is not None
    np.testing.assert_allclose(again.cylinder.covariance, engine.cylinder.covariance, rtol=1e-3, atol=1e-6)


def test_pieces_cover_the_recording() -> None:
    spans = pieces(1803.4)
    assert len(spans) == 6 and spans[0][0] == 0.0 and spans[-1][1] > 1803.4
    assert all(a[1] == b[0] for a, b in pairwise(spans))


@pytest.fixture(scope="module")
def liu_engine(liu: Path) -> PetrolParameters:
    """Maps of the real engine; the threshold is the default one."""
    return fit_maps(read_petrol(liu / "wltp_NF.csv").signals, PetrolParameters())[0]


REAL = [("wltp_f_pic_110.csv", "p_ic_gain", 0.10, 120.0), ("wltp_f_pim_090.csv", "p_im_gain", -0.10, 190.0),
        ("wltp_f_waf_110.csv", "w_af_gain", 0.10, 120.0)]  # fmt: skip


@pytest.mark.parametrize(("file", "name", "size", "onset_s"), REAL, ids=[r[1] for r in REAL])
def test_real_sensor_faults(
    liu: Path, liu_engine: PetrolParameters, file: str, name: str, size: float, onset_s: float
) -> None:
    d = discover_petrol(read_petrol(liu / file), liu_engine).document
    assert d.mismatch and d.location is not None and d.effects[0].name == name
    assert NONE_OF_THESE not in d.effects[0].names
    assert d.effects[0].magnitude == pytest.approx(size, abs=0.005)
    assert d.location.onset_s == pytest.approx(onset_s, abs=4.0)


def test_real_fault_free(liu: Path, liu_engine: PetrolParameters) -> None:
    assert not discover_petrol(read_petrol(liu / "wltp_NF.csv"), liu_engine).document.mismatch
