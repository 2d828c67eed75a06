"""Reading of code by several threads at once, as Prefect's and our own do."""

from __future__ import annotations

import ast
import gc
import inspect
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from tasks.code_reading import parsed

TEXTS = [f"{inspect.getsource(ast)}\nN = {number}\n" for number in range(24)]


def _deeper(levels: int, work: Callable[[], bool]) -> bool:
    return work() if levels == 0 else _deeper(levels - 1, work)


def test_threads_that_parse_at_once_all_get_their_trees() -> None:
    """`make repro` ended in "SystemError: AST constructor recursion depth mismatch" once: Python's own count of a
    tree's depth was another thread's (before 3.11.8), which begins at another depth of calls."""

    def others_come_between(phase: str, info: dict[str, int]) -> None:
        time.sleep(0)

    threshold = gc.get_threshold()
    gc.callbacks.append(others_come_between)
    gc.set_threshold(100)
    try:
        with ThreadPoolExecutor(3) as pool:
            made = list(pool.map(lambda item: _deeper(40 * (item[0] % 3), lambda: bool(parsed(item[1]).body)),
                                 enumerate(TEXTS)))
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.remove(others_come_between)
    assert all(made)
