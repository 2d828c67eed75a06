"""Files of trained networks: tensors and JSON meta data together, written atomically, equal content in equal bytes."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from dieseltwin.atomic import write_bytes
from dieseltwin.errors import InputError
from dieseltwin.networks.deeponet import CausalityDeepONet
from dieseltwin.networks.multi_head import MultiHead
from dieseltwin.networks.perceptron import MLP

FILE_SCHEMA = 1


def save_state(path: str | Path, state: Mapping[str, Any], meta: Mapping[str, Any]) -> Path:
    """Write tensors and JSON meta data to one file, atomically.

    Raises:
        InputError: full disk, read-only or missing folder.
    """
    buffer = io.BytesIO()  # a buffer, because torch.save writes a file's own name into it
    torch.save({"schema": FILE_SCHEMA, "meta": json.dumps(meta, sort_keys=True), "state": dict(state)}, buffer)
    return write_bytes(path, buffer.getvalue())


def load_state(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Tensors and meta data of a file of `save_state`.

    Raises:
        InputError: no such file, not a file of `save_state`, another schema.
    """
    path = Path(path)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(str(path), "no such file", "a trained network", "run the pretraining first") from None
    except Exception as error:  # the unpickler answers damaged bytes with whatever it stumbles over
        raise InputError(str(path), f"{error}"[:120], "a trained network's file", "train it again") from error
    if not isinstance(content, dict) or content.get("schema") != FILE_SCHEMA:
        raise InputError(str(path), "another format", f"a network file of schema {FILE_SCHEMA}", "train it again")
    return content["state"], json.loads(content["meta"])


_KINDS: Mapping[str, Callable[..., nn.Module]] = {
    "MLP": MLP,
    "MultiHead": MultiHead,
    "CausalityDeepONet": CausalityDeepONet.from_spec,
}


def network_from_spec(spec: Mapping[str, Any]) -> nn.Module:
    """Network of the structure that `spec()` of another one described; its weights are not those of the other."""
    options = dict(spec)
    kind = options.pop("kind", None)
    if kind not in _KINDS:
        raise InputError("kind of network", repr(kind), sorted(_KINDS), "take one of these")
    options["dtype"] = getattr(torch, options["dtype"])
    for pair in ("first_scale", "trunk_slopes"):
        if options.get(pair) is not None:
            options[pair] = tuple(options[pair])
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
