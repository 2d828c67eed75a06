"""One process per core, one thread each: cases are independent, and a case's time then means one core."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

_AT_START = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")  # read when a process loads its libraries
_AT_ANY_TIME = ("DIESELTWIN_THREADS",)

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def _one_thread(names: Sequence[str]) -> Iterator[None]:
    saved = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Iterator[tuple[int, Result]]:
    """Results with the positions of their items, as they come.

    One job or one item stays in this process where its libraries have been told to use one thread
    (OMP_NUM_THREADS=1); else it has a process of its own, so that its time means one core too.

    Args:
        work: picklable with its items and results.
    """
    if (jobs <= 1 or len(items) <= 1) and os.environ.get("OMP_NUM_THREADS") == "1":
        for k, item in enumerate(items):
            with _one_thread(_AT_ANY_TIME):
                result = work(item)
            yield k, result
        return
    if not items:
        return
    workers = max(1, min(jobs, len(items)))
    with (
        _one_thread((*_AT_START, *_AT_ANY_TIME)),
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
    ):
        futures = {pool.submit(work, item): k for k, item in enumerate(items)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)
