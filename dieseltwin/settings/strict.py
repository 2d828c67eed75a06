"""Settings from YAML into frozen models, strictly: an unknown key is an error that says what was probably meant."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from dieseltwin.errors import InputError
from dieseltwin.paths import refuse_unreadable
from dieseltwin.sealed import check_text
from dieseltwin.settings.names import LISTED_NAMES, did_you_mean, listed, refuse_options, unknown_name
from dieseltwin.settings.plain_yaml import plain_yaml

__all__ = [
    "FrozenModel", "LISTED_NAMES", "StrictModel", "did_you_mean", "holds_boolean", "listed", "overridden",
    "read_mapping", "read_profile", "refuse_options", "unknown_name", "validate", "where_told",
]  # fmt: skip


def where_told(usual: Any = None, **more: Any) -> Any:
    """A field that stands in the file only where it says something else than usual; `more` as of pydantic's `Field`."""
    return Field(default=usual, exclude_if=lambda value: value == usual, **more)


class FrozenModel(BaseModel):
    """Base of documents that are read in pydantic's strict mode: frozen, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, protected_namespaces=())


class StrictModel(FrozenModel):
    """Base of all settings: no yes or no for a number either.

    The strict mode refuses that by itself, and it doesn't take a JSON array for a tuple behind a validator in Python.
    """

    @field_validator("*", mode="before")
    @classmethod
    def _no_yes_for_a_number(cls, value: Any, info: ValidationInfo) -> Any:
        if holds_boolean(value) and not _takes_boolean(cls.model_fields[info.field_name or ""].annotation):
            raise ValueError(NO_YES_FOR_A_NUMBER)
        return value


def holds_boolean(value: Any) -> bool:
    """Whether a value is a boolean, or a list or mapping that directly holds one."""
    if isinstance(value, Mapping):
        value = tuple(value.values())
    return isinstance(value, bool) or (isinstance(value, list | tuple) and any(isinstance(v, bool) for v in value))


def _takes_boolean(annotation: Any) -> bool:
    """Whether a field's type has a place for a boolean, directly or in a model of its own."""
    if annotation in (bool, Any, object):
        return True
    if isinstance(annotation, type) and not typing.get_args(annotation):
        return issubclass(annotation, BaseModel)
    return any(_takes_boolean(part) for part in typing.get_args(annotation))


Model = TypeVar("Model", bound=BaseModel)
NO_YES_FOR_A_NUMBER = "no number but yes or no; YAML reads true, yes and on so"


def read_mapping(path: str | Path) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping; an empty file is an empty mapping.

    Keys are text as they stand in the file ("on" and "1" too), and a date is text.

    Raises:
        InputError: no such file, not readable, not plain YAML, a key twice, not a mapping, or another content than its
            checksum says.
    """
    path = Path(path)
    refuse_unreadable(path, "a YAML file")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), error, "a readable YAML file in UTF-8", "check the file") from None
    check_text(text, str(path))
    loaded = plain_yaml(text, str(path))
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise InputError(str(path), f"a {type(loaded).__name__}", "a mapping of names to values", "mend the file")
    return loaded


def read_profile(path: Path, profile: str) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """A settings file's common part, and what its `profiles: NAME` changes.

    Raises:
        InputError: a file that `read_mapping` refuses, an unknown profile.
    """
    common = read_mapping(path)
    profiles = common.pop("profiles", {}) or {}
    if not isinstance(profiles, Mapping):
        raise InputError(f"{path}: profiles", f"a {type(profiles).__name__}", "a mapping", "mend it")
    if not profiles:
        raise InputError(f"{path}: profiles", "none", f"profiles, {profile} among them",
                         "add them, or name another file of settings (--params)")  # fmt: skip
    if profile not in profiles:
        raise unknown_name(f"{path}: profiles", profile, list(profiles))
    overrides = profiles[profile] or {}
    if not isinstance(overrides, Mapping):
        raise InputError(f"{path}: profiles.{profile}", f"a {type(overrides).__name__}", "a mapping", "mend it")
    return common, overrides


def overridden(common: Mapping[str, Any], overrides: Mapping[str, Any], where: str) -> dict[str, Any]:
    """`common` with the values of `overrides` in place of its own, at any depth.

    Raises:
        InputError: a key that `common` doesn't have: a typing error.
    """
    result = dict(common)
    for key, value in overrides.items():
        if key not in common:
            raise unknown_name(where, str(key), [str(k) for k in common])
        both = isinstance(value, Mapping) and isinstance(common[key], Mapping)
        result[key] = overridden(common[key], value, f"{where}.{key}") if both else value
    return result


def validate(model: type[Model], values: Mapping[str, Any], where: str) -> Model:
    """Build `model` from `values`; the first problem becomes a one-line InputError starting with `where`."""
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        # an unknown key explains the missing one beside it, so it comes first
        problem = min(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    location = [str(part) for part in problem["loc"]]
    place = f"{where}: {'.'.join(location)}" if location else where
    if problem["type"] == "extra_forbidden":
        parent = _model_at(model, problem["loc"][:-1])
        known = list(parent.model_fields) if parent is not None else []
        above = ".".join(location[:-1])
        raise unknown_name(f"{where}: {above}" if above else where, location[-1], known)
    if problem["type"] == "missing":
        raise InputError(place, "nothing", "a value is needed", "add this key")
    allowed = asked_of(problem["msg"])
    if not location:  # of the whole, whose text would leave no room for what is wrong
        raise InputError(where, "values that don't go together", allowed, "change one of them")
    raise InputError(place, repr(problem["input"]), allowed, "change this value")


def asked_of(message: str) -> str:
    """What a message of pydantic asks of a value, without the words around it."""
    return message.removeprefix("Value error, ").replace("Input should be ", "")


def _model_at(model: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel] | None:
    """The model that a location of a pydantic error leads to, or None where there is none."""
    annotation: Any = model
    for part in location:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            field = annotation.model_fields.get(str(part))
            if field is None:
                return None
            annotation = field.annotation
        else:
            annotation = _value_type(annotation)
        annotation = _without_none(annotation)
    return annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None


def _value_type(annotation: Any) -> Any:
    """The type of the values of a mapping or sequence annotation."""
    arguments = [a for a in typing.get_args(annotation) if a is not Ellipsis]
    return arguments[-1] if arguments else None


def _without_none(annotation: Any) -> Any:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        kept = [a for a in typing.get_args(annotation) if a is not type(None)]
        return kept[0] if kept else None
    return annotation
