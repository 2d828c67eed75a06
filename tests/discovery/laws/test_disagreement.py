"""Laws that may be the true one widen what is said of health, by how near they come."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.laws.refit import disagreement


def _refit(point: str, score: float, *parameters: float) -> Any:
    law = SimpleNamespace(form=SimpleNamespace(point=point))
    return SimpleNamespace(
        twin=SimpleNamespace(laws=[law]), score=score, gain=score,
        fit=SimpleNamespace(parameters=np.array([*parameters, 7.0])),
    )  # fmt: skip


def test_another_point_just_behind_counts_and_one_far_behind_does_not() -> None:
    best = _refit("eta_tm", 10_000.0, 1.0, 2.0)
    near, far = _refit("eta_c", 9_500.0, 1.3, 2.0), _refit("eta_vol", 2_000.0, 5.0, 9.0)
    weight = np.exp(-1.0)  # 5 % of the gain behind
    apart = disagreement(best, [best, near, far], 2)
    assert apart == pytest.approx([0.3 * np.sqrt(weight / (1.0 + weight)), 0.0], abs=5e-3)


def test_only_the_best_law_of_another_point_counts_and_every_form_of_ones_own() -> None:
    best = _refit("eta_c", 10_000.0, 1.0)
    others = [_refit("eta_tm", 10_000.0 - behind, 1.2) for behind in (0.0, 1.0, 2.0)]
    assert disagreement(best, [best, *others], 1) == pytest.approx([0.2 * np.sqrt(0.5)])
    forms = [_refit("eta_c", 10_000.0, 1.2) for _ in range(3)]
    assert disagreement(best, [best, *forms], 1) == pytest.approx([0.2 * np.sqrt(0.75)])


def test_a_law_without_others_says_what_its_own_fit_says() -> None:
    best = _refit("eta_c", 40.0, 1.0)
    assert not disagreement(best, [best], 1).any()
