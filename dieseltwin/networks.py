"""Networks of the twin: perceptrons with dropout that stays on, multi-head networks, causality DeepONets.

Nothing here knows the engine. Initialisation, structure and the use of dropout follow the paper (Nath et al., sections
"Neural network surrogates for empirical formulae", "DeepONets for EGR and VGT states" and "Training of multi-head
neural networks"). A network is made of its `spec()` (plain JSON) and its state dict; `save_network` and `load_network`
keep both in one file that is written atomically.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from dieseltwin.errors import InputError
from dieseltwin.network_files import load_state, save_state

ACTIVATIONS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "tanh": torch.tanh,
    "sin": torch.sin,
    "relu": torch.relu,
    "silu": nn.functional.silu,
    "softplus": nn.functional.softplus,
    "identity": lambda z: z,
}
HIDDEN_GAIN = 2.0  # weights ~ N(0, gain / (in + out)): paper, section on the multi-head networks
HEADS_GAIN = 10.0  # the same for the last layer of a multi-head network


class MLP(nn.Module):
    """Fully connected network, or `members` of them stacked in one tensor program.

    Args:
        widths: (in, hidden ..., out) number of neurons of each layer.
        activation: name in ACTIVATIONS, used after each layer but the last (see `activate_last`).
        dropout: share of hidden neurons switched off. It stays on in `eval()` mode too, as in the paper; pass
            `masks=no_dropout` to leave it out, or masks of `sample_masks` to keep one realisation.
        members: None for a single network, else the number of stacked networks of equal widths.
        last_gain: weights of the last layer are drawn from N(0, last_gain / (in + out)).
        activate_last: apply the activation after the last layer too (the body of a multi-head network).
        generator: source of the initial weights; the global one of torch where None.
        dtype: of the weights.

    Shapes: x is (..., n, in), or (n, in) shared by all members; the result is (..., n, out), with members
    (members, n, out).
    """

    def __init__(
        self,
        widths: Sequence[int],
        activation: str = "tanh",
        dropout: float = 0.0,
        *,
        members: int | None = None,
        last_gain: float = HIDDEN_GAIN,
        activate_last: bool = False,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if len(widths) < 2 or any(int(w) < 1 for w in widths):
            raise InputError("MLP widths", list(widths), "two or more positive layer sizes", "correct the widths")
        if activation not in ACTIVATIONS:
            raise InputError("activation", repr(activation), sorted(ACTIVATIONS), "take one of these")
        if not 0.0 <= dropout < 1.0:
            raise InputError("dropout", dropout, "0 <= dropout < 1", "correct the share")
        self.widths = tuple(int(w) for w in widths)
        self.activation = activation
        self.dropout = float(dropout)
        self.members = members
        self.last_gain = float(last_gain)
        self.activate_last = activate_last
        stack = () if members is None else (int(members),)
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        last = len(self.widths) - 2
        for layer, (n_in, n_out) in enumerate(zip(self.widths[:-1], self.widths[1:], strict=True)):
            gain = self.last_gain if layer == last else HIDDEN_GAIN
            draw = torch.randn((*stack, n_in, n_out), generator=generator, dtype=dtype)
            self.weights.append(nn.Parameter(draw * math.sqrt(gain / (n_in + n_out))))
            self.biases.append(nn.Parameter(torch.zeros((*stack, 1, n_out), dtype=dtype)))

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return self.widths[1:-1]

    def spec(self) -> dict[str, Any]:
        """Plain JSON from which `network_from_spec` makes a network of the same structure."""
        return {
            "kind": "MLP",
            "widths": list(self.widths),
            "activation": self.activation,
            "dropout": self.dropout,
            "members": self.members,
            "last_gain": self.last_gain,
            "activate_last": self.activate_last,
            "dtype": str(self.weights[0].dtype).removeprefix("torch."),
        }

    def sample_masks(
        self, lead: Sequence[int] = (), *, generator: torch.Generator | None = None
    ) -> tuple[Tensor, ...]:
        """One dropout realisation: a mask for each hidden layer, 0 or 1 / (1 - dropout).

        Args:
            lead: leading shape of the masks. () gives (width,) for a single network and (members, 1, width) for a
                stacked one: the same neurons are off for all rows, as one realised engine. (runs, 1) gives each of
                `runs` batches its own realisation; (n,) a fresh one for each of n rows.
            generator: source of the draws.
        """
        if not lead and self.members is not None:
            lead = (self.members, 1)
        keep = 1.0 - self.dropout
        reference = self.weights[0]
        masks = []
        for width in self.hidden:
            uniform = torch.rand((*lead, width), generator=generator, dtype=reference.dtype)
            masks.append((uniform < keep).to(reference.dtype) / keep)
        return tuple(masks)

    def forward(
        self,
        x: Tensor,
        masks: Sequence[Tensor] | None = None,
        *,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Evaluate the network.

        Args:
            x: (..., n, in).
            masks: of `sample_masks`, `no_dropout` (= ()) for none; None draws a fresh mask for each row and hidden
                layer where dropout > 0.
            generator: source of these fresh masks.
        """
        act = ACTIVATIONS[self.activation]
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            # bias is (1, out), and (members, 1, out) for a stack, which broadcasts against (..., n, out)
            x = torch.matmul(x, weight) + bias
            if layer < last:
                x = act(x)
                if masks is None:
                    if self.dropout > 0.0:
                        keep = 1.0 - self.dropout
                        uniform = torch.rand(x.shape, generator=generator, dtype=x.dtype)
                        x = x * ((uniform < keep).to(x.dtype) / keep)
                elif len(masks) > 0:
                    x = x * masks[layer]
            elif self.activate_last:
                x = act(x)
        return x

    def member(self, index: int) -> MLP:
        """Copy of one member of a stack as a single network."""
        if self.members is None or not 0 <= index < self.members:
            raise InputError("member", index, f"0 to {(self.members or 0) - 1} of a stacked network", "correct it")
        single = network_from_spec({**self.spec(), "members": None})
        if not isinstance(single, MLP):
            raise TypeError("spec() of an MLP must make an MLP")
        with torch.no_grad():
            for mine, stacked in zip(single.parameters(), self.parameters(), strict=True):
                mine.copy_(stacked[index])
        return single


no_dropout: tuple[Tensor, ...] = ()


def stack_members(networks: Sequence[MLP]) -> MLP:
    """Stack single networks of equal structure into one with `members = len(networks)`."""
    if not networks:
        raise InputError("stack_members", "no network", "one or more", "give networks")
    specs = {json.dumps(network.spec(), sort_keys=True) for network in networks}
    if len(specs) != 1 or networks[0].members is not None:
        raise InputError("stack_members", sorted(specs), "single networks of equal structure", "stack likes only")
    stacked = network_from_spec({**networks[0].spec(), "members": len(networks)})
    if not isinstance(stacked, MLP):
        raise TypeError("spec() of an MLP must make an MLP")
    with torch.no_grad():
        for target, *sources in zip(
            stacked.parameters(), *(network.parameters() for network in networks), strict=True
        ):
            target.copy_(torch.stack([s.detach() for s in sources]))
    return stacked


class MultiHead(nn.Module):
    """A body shared by many linear heads: y(t) = h(t) W_out + b_out (paper, Eq. "Few shot output").

    Args:
        widths: (in, hidden ..., k, heads); k is the width of the last hidden layer, the number of basis functions.
        first_scale: None for the paper's initial weights in the first layer. Else the first layer is
            tanh(a (x - c)) with slopes a ~ +-U(scale_low, scale_high) and centres c spread evenly over [-1, 1]
            with a jitter: a body of well-conditioned, local bases.
    """

    def __init__(
        self,
        widths: Sequence[int],
        activation: str = "tanh",
        *,
        first_scale: tuple[float, float] | None = None,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if len(widths) < 3:
            raise InputError("MultiHead widths", list(widths), "(in, hidden ..., k, heads)", "correct them")
        self.widths = tuple(int(w) for w in widths)
        self.activation = activation
        self.first_scale = first_scale
        self.body = MLP(self.widths[:-1], activation, activate_last=True, generator=generator, dtype=dtype)
        self.head = MLP(self.widths[-2:], last_gain=HEADS_GAIN, generator=generator, dtype=dtype)
        if first_scale is not None:
            self._spread_first_layer(first_scale, generator)

    def _spread_first_layer(self, scale: tuple[float, float], generator: torch.Generator | None) -> None:
        weight, bias = self.body.weights[0], self.body.biases[0]
        if weight.shape[0] != 1:
            raise InputError("first_scale", f"{weight.shape[0]} inputs", "a scalar input", "leave it out")
        n = weight.shape[1]
        low, high = scale
        uniform = torch.rand((3, n), generator=generator, dtype=weight.dtype)
        slope = (low + (high - low) * uniform[0]) * torch.where(uniform[1] < 0.5, -1.0, 1.0).to(weight.dtype)
        # centres reach a little beyond the interval, so that its ends are as well covered as its middle
        grid = torch.linspace(-1.0, 1.0, n, dtype=weight.dtype) * (1.0 + 1.0 / n)
        centre = grid + (uniform[2] - 0.5) * (2.0 / n)
        with torch.no_grad():
            weight.copy_(slope[None, :])
            bias.copy_((-slope * centre)[None, :])

    def spec(self) -> dict[str, Any]:
        """Plain JSON from which `network_from_spec` makes a network of the same structure."""
        return {
            "kind": "MultiHead",
            "widths": list(self.widths),
            "activation": self.activation,
            "first_scale": None if self.first_scale is None else list(self.first_scale),
            "dtype": str(self.body.weights[0].dtype).removeprefix("torch."),
        }

    def forward(self, x: Tensor) -> Tensor:
        """(n, in) -> (n, heads), before any output transformation."""
        return self.head(self.body(x))

    def basis(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Last hidden layer h (n, k) and its derivative dh/dx (n, k) by forward-mode differentiation.

        Args:
            x: (n, 1), a scalar input.
        """
        if self.widths[0] != 1:
            raise InputError("basis", f"{self.widths[0]} inputs", "a scalar input", "differentiate otherwise")
        h, dh = torch.func.jvp(self.body, (x,), (torch.ones_like(x),))
        return h, dh


class CausalityDeepONet(nn.Module):
    """Operator from an input signal u and initial values to outputs that never see the future (Liu et al. 2022).

    For each output there is one branch on the input's history and one on the initial value; one trunk on time is
    shared. At time t_i the input branch gets the row (u_i, u_{i-1}, ..., u_0, 0, ..., 0) of `n_times` entries: the rows
    of a window make a Toeplitz matrix, so the branch's first layer is a causal convolution. Outputs are
    G(u, y_0)(t_i) = T(b + sum_j input_branch_j(row_i) initial_branch_j(y_0) trunk_j(t_i)), with T a soft clip to [0, 1]
    (inputs, outputs and limits are scaled to [0, 1] by the caller).

    Args:
        n_times: samples in a window.
        outputs: number of outputs (each has two branches).
        input_hidden, initial_hidden, trunk_hidden: widths of the hidden layers.
        n_basis: number of terms in the sum.
        activation: of all hidden layers.
        clip_sharpness: of the soft clip, see `soft_clip`.
        generator: source of the initial weights.
    """

    def __init__(
        self,
        n_times: int,
        outputs: int,
        *,
        input_hidden: Sequence[int] = (40, 40),
        initial_hidden: Sequence[int] = (20,),
        trunk_hidden: Sequence[int] = (40, 40),
        n_basis: int = 40,
        activation: str = "tanh",
        clip_sharpness: float = 100.0,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if n_times < 2 or outputs < 1:
            raise InputError("n_times, outputs", (n_times, outputs), ">= 2 and >= 1", "correct them")
        self.n_times = int(n_times)
        self.outputs = int(outputs)
        self.input_hidden = tuple(input_hidden)
        self.initial_hidden = tuple(initial_hidden)
        self.trunk_hidden = tuple(trunk_hidden)
        self.n_basis = int(n_basis)
        self.activation = activation
        self.clip_sharpness = float(clip_sharpness)

        def make(widths: Sequence[int]) -> MLP:
            return MLP(widths, activation, generator=generator, dtype=dtype)

        self.input_branches = nn.ModuleList(
            make((n_times, *self.input_hidden, n_basis)) for _ in range(outputs)
        )
        self.initial_branches = nn.ModuleList(
            make((1, *self.initial_hidden, n_basis)) for _ in range(outputs)
        )
        self.trunk = make((1, *self.trunk_hidden, n_basis))
        self.offset = nn.Parameter(torch.zeros(outputs, dtype=dtype))

    def spec(self) -> dict[str, Any]:
        """Plain JSON from which `network_from_spec` makes a network of the same structure."""
        return {
            "kind": "CausalityDeepONet",
            "n_times": self.n_times,
            "outputs": self.outputs,
            "input_hidden": list(self.input_hidden),
            "initial_hidden": list(self.initial_hidden),
            "trunk_hidden": list(self.trunk_hidden),
            "n_basis": self.n_basis,
            "activation": self.activation,
            "clip_sharpness": self.clip_sharpness,
            "dtype": str(self.offset.dtype).removeprefix("torch."),
        }

    def times(self) -> Tensor:
        """Sample times of a window scaled to [-1, 1], (n_times, 1)."""
        return torch.linspace(-1.0, 1.0, self.n_times, dtype=self.offset.dtype)[:, None]

    def rows(self, u: Tensor) -> Tensor:
        """Toeplitz rows of windows: (B, n) -> (B, n, n_times), newest sample first, zeros before the window."""
        if u.shape[-1] > self.n_times:
            raise InputError("window", f"{u.shape[-1]} samples", f"<= {self.n_times}", "cut it into windows")
        padded = nn.functional.pad(u, (self.n_times - 1, 0))
        return padded.unfold(-1, self.n_times, 1).flip(-1)

    def from_rows(self, rows: Tensor, initial: Tensor, time: Tensor) -> Tensor:
        """Outputs for rows of histories.

        Args:
            rows: (..., n_times) scaled histories, newest sample first.
            initial: (..., outputs) or a shape that broadcasts, scaled initial values of the window.
            time: (..., 1) or a shape that broadcasts, time since the window's start, scaled to [-1, 1].

        Returns:
            (..., outputs), within [0, 1].
        """
        trunk = self.trunk(time)
        columns = []
        for k in range(self.outputs):
            terms = self.input_branches[k](rows) * self.initial_branches[k](initial[..., k : k + 1]) * trunk
            columns.append(terms.sum(-1) + self.offset[k])
        return soft_clip(torch.stack(columns, dim=-1), self.clip_sharpness)

    def forward(self, u: Tensor, initial: Tensor) -> Tensor:
        """Windows (B, n) with initial values (B, outputs), both scaled to [0, 1] -> (B, n, outputs)."""
        return self.from_rows(self.rows(u), initial[:, None, :], self.times()[: u.shape[-1]])


def soft_clip(z: Tensor, sharpness: float = 100.0) -> Tensor:
    """Smooth limiter to [0, 1]: softplus(z) - softplus(z - 1) with `sharpness`; the identity well inside.

    Unlike a sigmoid it leaves a linear operator linear between the limits; it is 0.69 / sharpness off at a limit.
    """
    softplus = nn.functional.softplus
    # softplus falls back on its linear branch above `threshold`; 40 keeps that switch below float64 rounding
    return softplus(z, sharpness, 40.0) - softplus(z - 1.0, sharpness, 40.0)


_KINDS: Mapping[str, Callable[..., nn.Module]] = {
    "MLP": MLP,
    "MultiHead": MultiHead,
    "CausalityDeepONet": CausalityDeepONet,
}


def network_from_spec(spec: Mapping[str, Any]) -> nn.Module:
    """Network of the structure that `spec()` of another one described; its weights are not those of the other."""
    options = dict(spec)
    kind = options.pop("kind", None)
    if kind not in _KINDS:
        raise InputError("kind of network", repr(kind), sorted(_KINDS), "take one of these")
    options["dtype"] = getattr(torch, options["dtype"])
    if options.get("first_scale") is not None:
        options["first_scale"] = tuple(options["first_scale"])
    return _KINDS[kind](**options)


def save_network(path: str | Path, network: nn.Module, meta: Mapping[str, Any] | None = None) -> Path:
    """Write a network of this module (structure, weights) and `meta` to one file, atomically."""
    spec = network.spec()  # type: ignore[operator]  # every class in _KINDS has it
    return save_state(path, network.state_dict(), {"spec": spec, "meta": dict(meta or {})})


def load_network(path: str | Path) -> tuple[nn.Module, dict[str, Any]]:
    """Network and meta data of a file of `save_network`, bit for bit."""
    state, meta = load_state(path)
    network = network_from_spec(meta["spec"])
    network.load_state_dict(state)
    return network, meta["meta"]
