"""The table of identified states."""

from __future__ import annotations

import numpy as np
import pytest
from segments import PAPER

from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import SegmentProblem


def test_states_table_holds_states_flows_and_bands(problem: SegmentProblem) -> None:
    table = identify_segments([problem], "classical", 2, 0, config=PAPER).states
    assert len(table) == len(problem.time_s)
    np.testing.assert_array_equal(table["time_s"], problem.time_s)
    for name in ("p_im_pa", "omega_t_rad_s", "x_r", "w_egr_kg_s", "t_em_k", "eta_c"):
        assert (table[f"{name}_lo"] <= table[f"{name}_hi"]).all()
    # The model fits its own data: readings scatter about the table by their noise.
    z = (table["omega_t_rad_s"] - problem.measured[:, 2]) / problem.sigma[2]
    assert np.std(z) == pytest.approx(1.0, abs=0.15)
    assert (table["p_im_pa_hi"] - table["p_im_pa_lo"]).mean() < problem.sigma[0]
