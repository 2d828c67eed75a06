"""Files of trained networks: tensors and JSON meta data together, written atomically, equal content in equal bytes.

A file carries a checksum over its meta data and the numbers of its tensors (schema 2). Files of schema 1 had none; they
are still read, as far as the checksums of the archive that they are agree.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from dieseltwin.atomic import write_bytes
from dieseltwin.errors import InputError
from dieseltwin.networks.deeponet import CausalityDeepONet
from dieseltwin.networks.multi_head import MultiHead
from dieseltwin.networks.perceptron import MLP

FILE_SCHEMA = 2
WITHOUT_CHECKSUM = 1  # schema


def save_state(path: str | Path, state: Mapping[str, Any], meta: Mapping[str, Any]) -> Path:
    """Write tensors and JSON meta data to one file, atomically.

    Raises:
        InputError: full disk, read-only or missing folder.
    """
    buffer = io.BytesIO()  # a buffer, because torch.save writes a file's own name into it
    text = json.dumps(meta, sort_keys=True)
    content = {"schema": FILE_SCHEMA, "meta": text, "state": dict(state), "sha256": _checksum(text, state)}
    torch.save(content, buffer)
    return write_bytes(path, buffer.getvalue())


def load_state(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Tensors and meta data of a file of `save_state`.

    Raises:
        InputError: no such file, not a file of `save_state`, another schema, or another content than was saved.
    """
    path = Path(path)
    try:
        _check_archive(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise InputError(str(path), "no such file", "a trained network", "run the pretraining first") from None
    except InputError:
        raise
    except Exception as error:  # the unpickler answers damaged bytes with whatever it stumbles over
        raise InputError(str(path), f"{error}"[:120], "a trained network's file", "train it again") from error
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema not in (WITHOUT_CHECKSUM, FILE_SCHEMA):
        raise InputError(str(path), "another format", f"a network file of schema {FILE_SCHEMA}", "train it again")
    try:
        state, meta = content["state"], content["meta"]
        whole = schema == WITHOUT_CHECKSUM or content["sha256"] == _checksum(meta, state)
        found = json.loads(meta)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(str(path), f"{error}"[:120], "a trained network's file", "train it again") from None
    if not whole:
        raise InputError(str(path), "other content than was saved (its SHA-256 differs)", "the file as it was saved",
                         "put the file back, or train it again")
    return state, found


def _check_archive(path: Path) -> None:
    """Compare every part of the archive with its own checksum, which torch doesn't look at.

    Raises:
        InputError: a part is another than was written.
    """
    with zipfile.ZipFile(path) as archive:
        broken = archive.testzip()
    if broken is not None:
        raise InputError(str(path), f"a damaged part ({broken})", "the file as it was saved",
                         "put the file back, or train it again")


def _checksum(meta: str, state: Mapping[str, Any]) -> str:
    """SHA-256 over meta data and all tensors: names, types, shapes, numbers."""
    digest = hashlib.sha256(meta.encode())
    for name, value in _leaves("", state):
        if isinstance(value, torch.Tensor):
            digest.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
            digest.update(value.detach().cpu().contiguous().numpy().tobytes())
        else:
            digest.update(f"{name} {value!r}".encode())
    return digest.hexdigest()


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """What nested mappings and lists hold, by path."""
    if isinstance(value, Mapping):
        for key in value:
            yield from _leaves(f"{name}/{key}", value[key])
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            yield from _leaves(f"{name}/{k}", item)
    else:
        yield name, value


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
