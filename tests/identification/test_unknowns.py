"""Masks, scalings and starts of the unknowns."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.unknowns import health_of, starts, to_masked, to_physical

positive = st.floats(1e-2, 1e2)


@given(st.tuples(positive, positive, positive, positive))
def test_masks_invert_each_other(factors: tuple[float, ...]) -> None:
    values = we2011.PARAMETERS.health() * np.array(factors)
    np.testing.assert_allclose(to_physical(to_masked(values)), values, rtol=1e-10)


@given(st.lists(st.floats(-30.0, 30.0), min_size=4, max_size=4))
def test_torch_and_numpy_agree_and_are_positive(masked: list[float]) -> None:
    ours = to_physical(np.array(masked))
    theirs = to_physical(torch.tensor(masked, dtype=torch.float64), torch)
    assert (ours > 0.0).all()
    np.testing.assert_allclose(theirs.numpy(), ours, rtol=1e-12)


def test_masks_are_those_of_the_paper() -> None:
    values = to_physical(np.array([0.3, 0.2, 0.1, 2.0]))
    np.testing.assert_allclose(
        values, [1e-4 * np.exp(0.3), 1e-4 * np.exp(0.2), np.log1p(np.exp(0.1)), 10 * np.exp(2.0)]
    )


def test_starts_spread_around_their_centre_in_masked_space() -> None:
    centre = we2011.PARAMETERS.health()
    masked = to_masked(starts(centre, 4000, np.random.default_rng(1), 0.2))
    np.testing.assert_allclose(masked.mean(axis=0), to_masked(centre), atol=0.02)
    np.testing.assert_allclose(masked.std(axis=0), 0.2, rtol=0.05)


def test_starts_repeat_with_their_seed_and_stay_at_the_centre_without_spread() -> None:
    centre = health_of(we2011.FIELD)
    np.testing.assert_array_equal(
        starts(centre, 3, np.random.default_rng(2), 0.2), starts(centre, 3, np.random.default_rng(2), 0.2)
    )
    np.testing.assert_allclose(starts(centre, 2, np.random.default_rng(0), sigma=0.0), [centre, centre], rtol=1e-12)


@pytest.mark.parametrize("values", [[1e-4, 1e-4, -1.0, 90.0], [1e-4, 1e-4, np.nan, 90.0], [1e-4, 1e-4, 1.0]])
def test_impossible_values_are_refused(values: list[float]) -> None:
    with pytest.raises(InputError):
        to_masked(values)
