"""What a simulation gives, and the threads it may use."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.sensors import N_READ_STATES

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Observations:
    """Simulated states and sensor signals of B lanes at n sample times.

    Attributes:
        states: p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K]; shape (B, n, 5).
        measured: in the order of `sensors.MEASURED`; shape (B, n, C).
    """

    states: np.ndarray
    measured: np.ndarray


def observations(out: np.ndarray, states: int) -> Observations:
    """What a kernel wrote (B, n, states + len(READ)): so many states, the sensors' own first, then `sensors.READ`."""
    measured = [*range(N_READ_STATES), *range(states, out.shape[-1])]
    return Observations(out[..., :states], out[..., measured])


SIMULATOR_THREADS = "dieseltwin"
"""Begin of the names of the simulator's threads."""


def thread_count() -> int:
    """Threads for batches: DIESELTWIN_THREADS, or else the processors this process may use."""
    configured = os.environ.get("DIESELTWIN_THREADS")
    if configured:
        try:
            return max(1, int(configured))
        except ValueError:
            raise InputError(
                "DIESELTWIN_THREADS", got=repr(configured), allowed="a whole number of threads", do="set or unset it"
            ) from None
    return len(os.sched_getaffinity(0))


@lru_cache(maxsize=1)
def pool(threads: int) -> ThreadPoolExecutor:
    """The threads of all simulations."""
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix=SIMULATOR_THREADS)


def in_threads(one: Callable[[T], R], items: Sequence[T], threads: int | None = None) -> list[R]:
    """What a function answers for each item, in their order; with several threads those of all simulations run it."""
    threads = thread_count() if threads is None else threads
    return list(pool(threads).map(one, items)) if threads > 1 and len(items) > 1 else list(map(one, items))
