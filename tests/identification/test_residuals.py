"""Physics residuals vanish where the engine moves, and their derivatives are those of the whole equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from dieseltwin.engine import HEALTH, Inputs, actuate, bind, constants, parameter_batch, simulate_states, we2011
from dieseltwin.identification.few_shot.residuals import PointModel, driven_inputs, physics_residuals
from dieseltwin.identification.few_shot.term_model import TermModel

Drive = Callable[..., Inputs]
FIELD = torch.log(torch.tensor(we2011.FIELD.health()))[None]


@pytest.fixture(scope="module")
def fine(drive: Drive) -> tuple[torch.Tensor, torch.Tensor, Inputs]:
    """States of the field engine at 1 ms over three seconds, and their central differences at the inner points."""
    inputs = drive(330, 16).resampled(0.001)
    actuation = actuate(inputs, we2011.FIELD, 0.001)
    start = np.array([1.4e5, 1.5e5, 5000.0])
    states = torch.tensor(simulate_states(actuation, parameter_batch(we2011.FIELD), start).states)
    step = inputs.time_s[1] - inputs.time_s[0]
    return states, (states[:, 2:, :3] - states[:, :-2, :3]) / (2.0 * step), inputs


def test_residuals_vanish_on_simulated_states(fine: tuple[torch.Tensor, torch.Tensor, Inputs]) -> None:
    states, rates, inputs = fine
    driven = driven_inputs(actuate(inputs, we2011.FIELD, 0.001))
    driven = type(driven)(*(v[1:-1] for v in driven))
    model = PointModel(we2011.PARAMETERS)
    point = model(states[:, 1:-1, :3], FIELD, driven, derivatives=False)
    settled = slice(500, None)  # the start is off balance by hundreds of kPa/s
    error = (rates - point.rates)[0, settled].abs().quantile(0.99, dim=0)
    size = point.rates[0, settled].abs().mean(dim=0)
    assert (error / size < 2e-3).all()

    c = model.with_health(list(torch.exp(FIELD).unbind(-1)))
    inner = tuple(states[:, 1:-1].unbind(-1))
    full = physics_residuals(bind("torch"), inner, tuple(rates.unbind(-1)), driven, c)
    assert full.x_r[0, settled].abs().max() < 1e-4
    assert full.T_1[0, settled].abs().max() < 0.05
    # ... and do not vanish at other parameters.
    wrong = model(states[:, 1:-1, :3], FIELD + torch.tensor([[0.0, 0.05, 0.0, 0.0]]), driven, derivatives=False)
    assert ((rates - wrong.rates)[0, settled, 1].abs().median() / error[1]) > 10.0


@pytest.mark.parametrize("with_terms", [False, True])
def test_residual_of_t_1_is_the_printed_one(fine: tuple[torch.Tensor, torch.Tensor, Inputs], with_terms: bool) -> None:
    """Off the fixed point: A.56e has the x_r of its own network, not the one that A.10 makes of T_1."""
    states, _, inputs = fine
    actuation = actuate(inputs, we2011.FIELD, 0.001)
    driven = driven_inputs(actuation)
    model = TermModel(None, we2011.FIELD, [actuation]) if with_terms else bind("torch")
    c = constants(we2011.FIELD)
    n = states.shape[1]
    sway = torch.linspace(0.0, 20.0, n, dtype=torch.float64).sin()
    x_r, T_1 = states[0, :, 3] * (1.0 + 0.3 * sway), states[0, :, 4] + 15.0 * sway.flip(0)
    x_r.requires_grad_()
    own = (*states[0, :, :3].unbind(-1), x_r, T_1)
    no_rates = (torch.zeros(n, dtype=torch.float64),) * 3
    found = physics_residuals(model, own, no_rates, driven, c).T_1
    T_e = model.quantities(*own, *driven, c).T_e
    torch.testing.assert_close(found, T_1 - (x_r * T_e + (1.0 - x_r) * c.T_im), rtol=0.0, atol=1e-9)
    (slope,) = torch.autograd.grad(found.sum(), x_r)
    assert (slope < -50.0).all()  # about T_im - T_e: the residual says something about x_r


def test_pointwise_jacobian_against_central_differences(fine: tuple[torch.Tensor, torch.Tensor, Inputs]) -> None:
    states, _, inputs = fine
    driven = driven_inputs(actuate(inputs, we2011.FIELD, 0.001))
    rows = slice(600, 2400, 150)
    driven = type(driven)(*(v[rows] for v in driven))
    x, model = states[:, rows, :3], PointModel(we2011.PARAMETERS)
    # The fixed point from a cold start needs more sweeps than one call before differences see nothing of it.
    start = model(x, FIELD, driven, derivatives=False).cylinder
    point = model(x, FIELD, driven, start=start)
    assert point.slopes is not None
    analytic = point.slopes.movedim(-1, 1)
    for j in range(7):
        step = 1e-5
        up, down, p_up, p_down = x.clone(), x.clone(), FIELD.clone(), FIELD.clone()
        if j < 3:
            up[..., j], down[..., j] = up[..., j] * (1.0 + step), down[..., j] * (1.0 - step)
            width = 2.0 * step * x[..., j : j + 1]
        else:
            p_up[:, j - 3], p_down[:, j - 3] = p_up[:, j - 3] + step, p_down[:, j - 3] - step
            width = torch.full_like(x[..., :1], 2.0 * step)
        a = model(up, p_up, driven, derivatives=False, start=start)
        b = model(down, p_down, driven, derivatives=False, start=start)
        numeric = torch.cat([a.rates - b.rates, a.readings - b.readings], -1) / width
        scale = analytic[..., j].abs().amax((0, 1)).clamp(min=1e-12)
        assert ((numeric - analytic[..., j]).abs().amax((0, 1)) / scale < 2e-3).all(), f"direction {j}"


def test_compiled_equations_are_those_that_torch_differentiates(
    fine: tuple[torch.Tensor, torch.Tensor, Inputs],
) -> None:
    states, _, inputs = fine
    driven = driven_inputs(actuate(inputs, we2011.FIELD, 0.001))
    compiled, eager = PointModel(we2011.PARAMETERS), PointModel(we2011.PARAMETERS)
    eager.compiled = False
    assert compiled.compiled
    health = torch.cat([FIELD, FIELD + 0.1])
    both = [model(states[..., :3].expand(2, -1, -1), health, driven) for model in (compiled, eager)]
    for name in ("values", "slopes"):
        mine, other = (getattr(point, name) for point in both)
        size = other.abs().amax(-1, keepdim=True).clamp(min=1e-30)
        torch.testing.assert_close(mine / size, other / size, rtol=0.0, atol=1e-9)
    torch.testing.assert_close(both[0].cylinder.x_r, both[1].cylinder.x_r)


def test_learned_maps_take_the_place_of_formulas(fine: tuple[torch.Tensor, torch.Tensor, Inputs]) -> None:
    states, _, inputs = fine
    driven = driven_inputs(actuate(inputs, we2011.FIELD, 0.001))
    formula = bind("torch").eta_vol
    maps = {"eta_vol": lambda p_im, n_e, c: 1.01 * formula(p_im, n_e, c)}
    exact = PointModel(we2011.PARAMETERS)(states[..., :3], FIELD, driven, derivatives=False)
    learned = PointModel(we2011.PARAMETERS, maps)(states[..., :3], FIELD, driven, derivatives=False)
    assert (learned.rates[..., 0] < exact.rates[..., 0]).all()  # more air leaves the intake manifold
    torch.testing.assert_close(learned.readings[..., 2], exact.readings[..., 2])  # W_c doesn't hang on it
    assert len(HEALTH) == 4
