"""What is decided by where no settings are given: those of a command's `--params`, of the process, or of the file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache

from dieseltwin.settings.discovery import DiscoverConfig, LearnConfig
from dieseltwin.settings.params import SECTIONS_VARIABLE, Params, load_params
from dieseltwin.settings.search import SearchConfig
from dieseltwin.settings.strict import StrictModel, validate
from dieseltwin.settings.watch import WatchConfig

_CHOSEN: ContextVar[Params | None] = ContextVar("chosen", default=None)


@contextmanager
def deciding_by(settings: Params) -> Iterator[None]:
    """While it lasts, `default_discover` and the like take these settings: those of a command's `--params`."""
    token = _CHOSEN.set(settings)
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def default_discover() -> DiscoverConfig:
    """What a discovery decides by where no settings are given: those that are chosen (`deciding_by`), else the
    process's own, else `default_params_path()`'s."""
    return _given().discover or load_params().discover


def default_search() -> SearchConfig:
    """The same of a search."""
    return default_discover().search


def default_learn() -> LearnConfig:
    """The same of learning."""
    return _given().learn or load_params().learn


def default_watch() -> WatchConfig:
    """The same of the alarm over a history."""
    return _given().watch or load_params().watch


class _Given(StrictModel):
    """Sections that stand for the file's."""

    discover: DiscoverConfig | None = None
    learn: LearnConfig | None = None
    watch: WatchConfig | None = None


def _given() -> _Given | Params:
    """The settings that were chosen, or the sections that the process was given."""
    chosen = _CHOSEN.get()
    return chosen if chosen is not None else _validated_sections(os.environ.get(SECTIONS_VARIABLE, "{}"))


@lru_cache(maxsize=8)
def _validated_sections(text: str) -> _Given:
    return validate(_Given, json.loads(text), SECTIONS_VARIABLE)
