"""An effect that shows in short bursts doesn't weigh itself down."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.discovery.laws.features import generic_features
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.petrol.components import signed_leak
from dieseltwin.petrol.discover import PetrolOptions, discover_petrol
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, read_petrol
from dieseltwin.petrol.twin import PetrolTwin

Recorder = Callable[..., PetrolRecording]
SINCE_S = 200.0


def leaking(record: Recorder, path: Path, area_m2: float) -> PetrolRecording:
    """A healthy recording, the flow of a hole before the throttle added to what is metered, and p_ic read noisily."""
    table = pd.read_csv(record(21, 420.0).path)
    columns = ("p_ic_Pa", "T_ic_K", "p_amb_Pa", "T_amb_K")
    lost = -signed_leak(area_m2, *(table[name].to_numpy() for name in columns))
    table["W_af_kg_s"] += np.where(table.time_s >= SINCE_S, lost, 0.0)
    table["p_ic_Pa"] += np.random.default_rng(21).normal(0.0, 250.0, len(table))
    table.to_csv(path, index=False)
    return read_petrol(path)


def test_a_hole_before_the_throttle_has_its_size(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    found = discover_petrol(leaking(record, tmp_path / "leak.csv", 2e-5), engine).document
    assert [effect.name for effect in found.effects] == ["boost_leak"] and found.location is not None
    # by seconds weighed as they jump, 16.6 +- 1.4 mm2
    assert found.effects[0].magnitude == pytest.approx(2e-5, rel=0.07)
    assert found.location.onset_s == pytest.approx(SINCE_S, abs=10.0)


def test_no_noise_reaches_a_healthy_engine_s_verdict(
    engine: PetrolParameters, record: Recorder, tmp_path: Path
) -> None:
    assert not discover_petrol(leaking(record, tmp_path / "healthy.csv", 0.0), engine).document.mismatch


def test_a_hole_is_known_by_its_name(engine: PetrolParameters, record: Recorder) -> None:
    found = prepare(PetrolTwin(engine, record(21, 420.0).signals), PetrolOptions().search)
    holes = [item for item in generic_features(found.twin, found.null.fit) if item.text.startswith("hole of")]
    assert {item.effect for item in holes} == {"intake_leak", "boost_leak"}


def test_a_map_s_error_weighs_more_beside_a_leak(engine: PetrolParameters, record: Recorder) -> None:
    """At idle with a leak the sensor reads half of what the cylinders take in: the map is off by twice that."""
    twin = PetrolTwin(engine, record(21, 420.0, leak_m2=1.5e-5).signals)
    plain = np.zeros((1, 0))
    parameters = np.zeros((1, len(twin.parameters)))
    alone = twin.nuisances(Lanes(parameters, plain, {}))
    beside = twin.nuisances(Lanes(parameters, plain, {"intake_leak": np.array([1.5e-5])}))
    fields = [np.stack([n.response for n in some if n.label.startswith("map of cylinder")])[:, :, 0]
              for some in (alone, beside)]  # fmt: skip
    size = [np.sqrt((field**2).sum(axis=0)) for field in fields]
    idle = (twin.blocks.omega_e < 118.0) & (twin.time_s > SINCE_S)
    fast = (twin.blocks.omega_e > 200.0) & (twin.blocks.p_im > 8e4)
    assert np.median((size[1] / size[0])[idle]) == pytest.approx(2.0, rel=0.3)
    assert np.median((size[1] / size[0])[fast]) == pytest.approx(1.1, abs=0.1)
