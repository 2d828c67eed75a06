"""Training of the six empirical maps on simulated laboratory recordings.

Labels are the recordings' own columns with Gaussian noise of 3 % of the mean absolute label (paper, section "Neural
network surrogates for empirical formulae"). Both kinds see the same noisy labels, but for
f_egr: Case-I as printed, all four cases in improved.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
import torch

from dieseltwin.engine import MAPS, EngineParameters, constants, we2011
from dieseltwin.errors import InputError
from dieseltwin.networks import MLP
from dieseltwin.settings.maps import ImprovedMapsConfig, MapsConfig, PaperMapsConfig
from dieseltwin.settings.strict import unknown_name
from dieseltwin.surrogates.empirical import LABELS, EmpiricalMaps, MapNetwork, map_arguments
from dieseltwin.surrogates.empirical_forms import (
    ETA_TM_CAP,
    ETA_TM_FLOOR,
    KINDS,
    Kind,
    bound_forms,
)
from dieseltwin.surrogates.small_networks import (
    Cells,
    Labels,
    Output,
    Structure,
    evaluate,
    fit_networks,
    make_cells,
    masked_parameters,
    n_parameters,
    start,
    tanh,
    unpack,
)
from dieseltwin.surrogates.speed_jump import find_jump

TRAINING_CASES = ("case_i", "case_ii", "case_iii", "case_iv")  # paper, case table
F_EGR_CASE = "case_i"  # paper: f_egr from Case-I only
Progress = Callable[[str, float], None]
"""Called with the map's name and the share of the training done."""

CENTRAL = (0.5, 99.5)  # % of the rows whose inputs are scaled to [-1, 1]
HARD_LIMITS = {"eta_tm": (ETA_TM_FLOOR, ETA_TM_CAP)}  # its output is z itself between them
NOISE_MIN = 1e-4  # of the mean absolute label: clean labels have the map's own curvature as noise
LIMIT_SIGMAS = 5.0  # standard deviations of a cell's mean label by which it is clearly inside
LIMIT_MARGIN = 0.25  # of an input's range beyond the training data, where the improved maps stop to extrapolate
Samples = dict[str, tuple[tuple[np.ndarray, ...], np.ndarray]]


@dataclass(frozen=True)
class MapData:
    """Recordings that the maps are trained on.

    Attributes:
        lab: clean recordings case_i to case_iv (others are left aside) with ambient and actuator columns.
        finer: the same cases sampled finer, for eta_tm (paper: 0.025 s); `lab` where None.
        held_out: clean recordings that are only evaluated, for the table of errors.
        engine: the laboratory engine.
    """

    lab: Mapping[str, pd.DataFrame]
    finer: Mapping[str, pd.DataFrame] | None = None
    held_out: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    engine: EngineParameters = we2011.PARAMETERS


def train_maps(
    data: MapData,
    config: MapsConfig,
    seed: int,
    kind: Kind,
    *,
    label_noise_rel: float = 0.03,
    progress: Progress | None = None,
) -> EmpiricalMaps:
    """Train the six maps.

    Args:
        data: laboratory recordings and their engine.
        config: `pretrain.maps` of params.yaml.
        seed: of label noise, starts and batches; the same seed gives the same bits on one thread.
        kind: "paper" or "improved".
        label_noise_rel: standard deviation of the label noise over the mean absolute label.
        progress: called as the training goes on.

    Raises:
        InputError: a case or column is missing. DieselTwinError: a fit has no finite start.
    """
    if kind not in KINDS:
        raise unknown_name("kind of maps", kind, list(KINDS))
    cases, parameters = _training_cases(data.lab), data.engine
    samples = _samples(kind, cases, _training_cases(data.finer or data.lab), parameters)
    noisy: Samples = {}
    for number, (name, (arguments, label)) in enumerate(samples.items()):
        rng = np.random.default_rng([seed, number])
        noise = label_noise_rel * np.mean(np.abs(label)) * rng.standard_normal(label.size)
        noisy[name] = (arguments, label + noise)
    fit = _train_paper if kind == "paper" else _train_improved
    maps = fit(noisy, config, seed, parameters, progress or (lambda name, share: None))
    meta = {"seed": seed, "label_noise_rel": label_noise_rel, "rows": {n: s[1].size for n, s in noisy.items()}}
    trained = EmpiricalMaps(kind, maps, parameters, meta)
    table = trained.error_table({**cases, **data.held_out})
    return EmpiricalMaps(kind, maps, parameters, meta, tuple(table.to_dict("records")))


def _training_cases(cases: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    missing = [name for name in TRAINING_CASES if name not in cases]
    if missing:
        raise InputError("maps: laboratory data", f"no {missing[0]}", ", ".join(TRAINING_CASES), "simulate that case")
    return {name: cases[name] for name in TRAINING_CASES}


def _samples(
    kind: Kind, cases: Mapping[str, pd.DataFrame], fine: Mapping[str, pd.DataFrame], parameters: EngineParameters
) -> Samples:
    """Arguments and clean labels of each map over the cases that it is trained on."""
    by_case = {case: map_arguments(frame, parameters) for case, frame in cases.items()}
    fine_by_case = {case: map_arguments(frame, parameters) for case, frame in fine.items()}
    samples: Samples = {}
    for name in MAPS:
        frames, arguments = (fine, fine_by_case) if name == "eta_tm" else (cases, by_case)
        chosen = [F_EGR_CASE] if name == "f_egr" and kind == "paper" else list(frames)
        columns = zip(*(arguments[case][name] for case in chosen), strict=True)
        label = np.concatenate([frames[case][LABELS[name]].to_numpy(dtype=np.float64) for case in chosen])
        samples[name] = (tuple(np.concatenate(parts) for parts in columns), label)
    return samples


def _scaling(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale (d,) that bring the central part of (n, d) inputs to [-1, 1]."""
    lower, upper = np.percentile(x, CENTRAL, axis=0)
    return 0.5 * (lower + upper), np.maximum(0.5 * (upper - lower), np.finfo(np.float64).tiny)


# --- as printed --------------------------------------------------------------------------------------------------


def _with_a_slope(restricted: torch.Tensor, z: torch.Tensor, name: str) -> torch.Tensor:
    """The restricted output, for eta_tm with the slope of the unrestricted one.

    min(0.818, z) has no slope above the cap: a network that once starts or jumps above it stays there for good (seen:
    the cap on 90 % of the rows). The value, and so the loss, is the printed one.
    """
    return z + (restricted - z).detach() if name == "eta_tm" else restricted


def _train_paper(
    samples: Samples, config: MapsConfig, seed: int, parameters: EngineParameters, progress: Progress
) -> dict[str, MapNetwork]:
    """Adam on the mean square error of the restricted outputs, dropout on; the six networks in one tensor program."""
    settings: PaperMapsConfig = config.paper
    forms = bound_forms("paper", "numpy")
    restrict = [bound_forms("paper", "torch")[name].output for name in MAPS]
    generator = torch.Generator().manual_seed(seed)
    widest = max(form.n_inputs for form in forms.values())
    stack = MLP(
        (widest, *settings.hidden, 1), settings.activation, settings.dropout_rel, members=len(MAPS), generator=generator
    )
    inputs, labels, scaling = [], [], {}
    c = constants(parameters)
    for number, name in enumerate(MAPS):
        arguments, label = samples[name]
        x = np.stack(forms[name].inputs(*arguments, c), axis=-1)
        centre, scale = _scaling(x)
        scaling[name] = (centre, scale)
        padded = np.zeros((label.size, widest))
        padded[:, : x.shape[1]] = (x - centre) / scale
        inputs.append(torch.as_tensor(padded, dtype=torch.float32))
        labels.append(torch.as_tensor(label, dtype=torch.float32))
        with torch.no_grad():
            stack.weights[0][number, x.shape[1] :] = 0.0
    optimiser = torch.optim.Adam(stack.parameters(), lr=settings.rate)
    for step in range(settings.steps):
        # from `rate` down to `rate_end` along half a cosine
        fall = 0.5 * (1.0 + math.cos(math.pi * step / settings.steps))
        optimiser.param_groups[0]["lr"] = settings.rate_end + (settings.rate - settings.rate_end) * fall
        rows = [torch.randint(len(y), (settings.batch,), generator=generator) for y in labels]
        x = torch.stack([a[r] for a, r in zip(inputs, rows, strict=True)])
        z = stack(x, generator=generator)[..., 0]
        outputs = [_with_a_slope(restrict[i](z[i], ()), z[i], name) for i, name in enumerate(MAPS)]
        loss = sum(torch.mean((outputs[i] - labels[i][rows[i]]) ** 2) for i in range(len(MAPS)))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        if step % 200 == 0:
            progress("six maps", step / settings.steps)
    maps = {}
    for number, name in enumerate(MAPS):
        d = forms[name].n_inputs
        single = MLP((d, *settings.hidden, 1), settings.activation, settings.dropout_rel, members=1)
        with torch.no_grad():
            for target, source in zip(single.parameters(), stack.parameters(), strict=True):
                target.copy_(source[number : number + 1, : target.shape[1]])
        centre, scale = scaling[name]
        if settings.finish_steps > 0 and name in settings.finish_maps:
            x = (np.stack(forms[name].inputs(*samples[name][0], c), axis=-1) - centre) / scale
            rng = np.random.default_rng([seed, number, 2])
            single = finish(name, single, x, samples[name][1], settings, rng)
        maps[name] = MapNetwork(single, np.full(d, -np.inf), np.full(d, np.inf), centre, scale)
    return maps


def finish(
    name: str, network: MLP, x: np.ndarray, label: np.ndarray, settings: PaperMapsConfig, rng: np.random.Generator
) -> MLP:
    """Gauss-Newton on averaged labels, with a little of the loss of a network that lacks a neuron.

    The mean over dropout realisations is, to first order, the network without dropout, and the estimators draw new
    realisations in every epoch; so that network is fitted, and each neuron missing on its own share of the cells keeps
    the realisations together (without it they scatter fivefold).

    Args:
        name: of the map.
        network: one tanh network (members=1).
        x: (n, d) scaled inputs; label: (n,).
        settings: cells, steps, ridge, and the weight of a missing neuron.
        rng: which cells each missing neuron is tried on.

    Returns:
        The network with other weights.

    Raises:
        InputError: another activation than tanh.
    """
    if network.activation != "tanh":
        raise InputError("finish_steps", f"{network.activation} network", "tanh", "set finish_steps to 0")
    widths, neurons = network.widths, sum(network.hidden)
    cells = make_cells(x, math.ceil(label.size / settings.finish_cells))
    at = np.stack([cells.mean(x[:, j]) for j in range(x.shape[1])])
    mean_label = cells.mean(label)
    sigma = _noise_of(cells, label, mean_label)
    k = mean_label.size
    ends = np.cumsum([0, *network.hidden])
    at_once = max(1, k // neurons)
    chosen, share = [np.arange(k)], [np.ones(k)]
    masked = [(slice(0, k), np.ones(n_parameters(widths)))]
    for missing in range(neurons):
        mask = np.arange(neurons) != missing
        factor = masked_parameters(widths, [mask[a:b] for a, b in itertools.pairwise(ends)])
        first = k + missing * at_once
        masked.append((slice(first, first + at_once), factor))
        chosen.append(rng.choice(k, at_once, replace=False))
        share.append(np.full(at_once, settings.finish_missing * k / at_once))
    rows = np.concatenate(chosen)
    doubt = LIMIT_SIGMAS * sigma / np.sqrt(cells.count)
    found = fit_networks(
        _packed(network),
        Structure(widths, tanh, masked),
        Labels(
            at[:, rows],
            mean_label[rows][None],
            (cells.count / sigma**2)[rows] * np.concatenate(share),
            _output_with_slope(name, at[:, rows], mean_label[rows], doubt[rows], "paper"),
        ),
        steps=settings.finish_steps,
        ridge=settings.finish_ridge,
    )
    return _as_mlp(found.unknowns, widths, "tanh", network.dropout).to(network.weights[0].dtype)


# --- improved ----------------------------------------------------------------------------------------------------


def _train_improved(
    samples: Samples, config: MapsConfig, seed: int, parameters: EngineParameters, progress: Progress
) -> dict[str, MapNetwork]:
    maps = {}
    for number, name in enumerate(MAPS):
        progress(name, number / len(MAPS))
        rng = np.random.default_rng([seed, number, 1])
        maps[name] = _fit_map(name, *samples[name], config.improved, parameters, rng)
    return maps


def _limits(name: str, x: np.ndarray, label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits (d,) of the network inputs (n, d)."""
    low, high = x.min(axis=0), x.max(axis=0)
    if name == "f_egr":
        return np.zeros(1), high  # beyond the widest position there is no data and hardly any more opening
    margin = LIMIT_MARGIN * (high - low)
    low, high = low - margin, high + margin
    if name == "eta_tm":
        jump = find_jump(x[:, 2], x[:, 0], label)
        if jump is not None:
            low[2], high[2] = jump
    return low, high


def _fit_map(
    name: str, arguments: tuple[np.ndarray, ...], label: np.ndarray, settings: ImprovedMapsConfig,
    parameters: EngineParameters, rng: np.random.Generator,
) -> MapNetwork:  # fmt: skip
    """Nominal network on the noisy labels, and members on labels with the noise drawn anew."""
    form = bound_forms("improved", "numpy")[name]
    x = np.stack(np.broadcast_arrays(*form.inputs(*arguments, constants(parameters))), axis=-1)
    low, high = _limits(name, x, label)
    x = np.clip(x, low, high)
    centre, scale = _scaling(x)
    widths = (x.shape[1], *settings.hidden[name], 1)
    scaled = (x - centre) / scale
    cells = make_cells(scaled, math.ceil(label.size / settings.cells))
    at = np.stack([cells.mean(scaled[:, j]) for j in range(x.shape[1])])
    raw = at * scale[:, None] + centre[:, None]
    mean_label = cells.mean(label)
    sigma = _noise_of(cells, label, mean_label)
    weight = cells.count / sigma**2
    output = _output_with_slope(name, raw, mean_label, LIMIT_SIGMAS * sigma / np.sqrt(cells.count))

    first = start(widths, at, settings.starts, settings.first_layer_scale, settings.start_level, rng)
    structure, labels = Structure(widths), Labels(at, mean_label[None], weight, output)
    tried = fit_networks(first, structure, labels, steps=settings.steps, ridge=settings.ridge)
    order = np.argsort(tried.linear.cost)
    good = order[tried.linear.cost[order] <= settings.accepted_cost_ratio * tried.linear.cost[order[0]]]
    nominal = tried.unknowns[order[:1]]
    bend = np.zeros_like(mean_label)
    for _ in range(settings.rounds):
        # what averaging did to the map itself: mean over the cell's rows less value at the mean of its inputs
        by_row = form.output(evaluate(nominal, widths, scaled.T)[0], tuple(x.T))
        bend = cells.mean(by_row) - output(evaluate(nominal, widths, at))[0][0]
        nominal = fit_networks(
            nominal,
            structure,
            replace(labels, y=(mean_label - bend)[None]),
            steps=settings.refine_steps,
            ridge=settings.ridge,
        ).unknowns
    redrawn = (mean_label - bend) + rng.standard_normal((settings.members, mean_label.size)) / np.sqrt(weight)
    from_starts = tried.unknowns[good[np.arange(settings.members) % good.size]]
    members = fit_networks(
        from_starts,
        structure,
        replace(labels, y=redrawn),
        steps=settings.refine_steps,
        ridge=settings.ridge,
    ).unknowns
    network = _as_mlp(np.concatenate([nominal, members]), widths)
    return MapNetwork(network, low, high, centre, scale, spread=settings.spread)


def _noise_of(cells: Cells, label: np.ndarray, mean_label: np.ndarray) -> float:
    """Standard deviation of the labels' noise: the usual scatter within a cell."""
    scatter = cells.mean((label - mean_label[cells.of_row]) ** 2) * cells.count / np.maximum(cells.count - 1.0, 1.0)
    return max(float(np.sqrt(np.median(scatter))), NOISE_MIN * float(np.mean(np.abs(label))))


def _output_with_slope(
    name: str, raw: np.ndarray, label: np.ndarray, doubt: np.ndarray, kind: Kind = "improved"
) -> Output:
    """The map's output restriction at cells (d, k) with its slope, by automatic differentiation.

    A cell whose label lies clearly (by `doubt`) inside the cap and floor is fitted without them: a network that starts
    beyond a limit there has no slope and would never come back.
    """
    restrict = bound_forms(kind, "torch")[name].output
    inputs = tuple(torch.as_tensor(row) for row in raw)
    floor, cap = HARD_LIMITS.get(name, (np.inf, -np.inf))
    inside = torch.as_tensor((label - doubt > floor) & (label + doubt < cap))

    def output(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tensor = torch.as_tensor(z).requires_grad_(True)
        value = torch.where(inside, tensor, restrict(tensor, inputs))
        (slope,) = torch.autograd.grad(value.sum(), tensor)
        return value.detach().numpy(), slope.numpy()

    return output


def _packed(network: MLP) -> np.ndarray:
    """Packed parameters (M, P) of a stack of networks."""
    layers = zip(network.weights, network.biases, strict=True)
    parts = [t.detach().double().transpose(1, 2).flatten(1) for layer in layers for t in layer]
    return torch.cat(parts, 1).numpy()


def _as_mlp(p: np.ndarray, widths: tuple[int, ...], activation: str = "algebraic", dropout: float = 0.0) -> MLP:
    """Packed parameters (M, P) as a stack of networks."""
    if p.shape[1] != n_parameters(widths):
        raise InputError("parameters", p.shape, f"(M, {n_parameters(widths)})", "use the fit's widths")
    stack = MLP(widths, activation, dropout, members=len(p), dtype=torch.float64)
    with torch.no_grad():
        for number, (weights, biases) in enumerate(unpack(p, widths)):
            stack.weights[number].copy_(torch.as_tensor(weights.transpose(0, 2, 1).copy()))
            stack.biases[number].copy_(torch.as_tensor(biases.transpose(0, 2, 1).copy()))
    return stack
