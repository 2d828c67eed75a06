"""One process per core, one thread each: cases are independent, and a case's time then means one core."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

_ONE_THREAD = ("OMP_NUM_THREADS", "DIESELTWIN_THREADS", "NUMBA_NUM_THREADS")

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def _one_thread() -> Iterator[None]:
    saved = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update({name: "1" for name in _ONE_THREAD})
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
    """Results with the positions of their items, as they come; in this process for one job or one item.

    Args:
        work: picklable with its items and results.
    """
    if jobs <= 1 or len(items) <= 1:
        for k, item in enumerate(items):
            yield k, work(item)
        return
    with _one_thread(), ProcessPoolExecutor(min(jobs, len(items)), mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(work, item): k for k, item in enumerate(items)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)
