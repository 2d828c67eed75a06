"""Figures drawn and encoded by two processes at once, as drawing takes one core for seconds."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, TypeAlias, TypeVar

from matplotlib.figure import Figure

from dieseltwin.report.beside import may_fork
from dieseltwin.report.style import DPI, ReportFigure

T = TypeVar("T")
Drawing: TypeAlias = Callable[[], ReportFigure | None]
"""Draws a figure; None where there is no data for it."""
Drawn: TypeAlias = Callable[[Mapping[str, Drawing]], Mapping[str, ReportFigure | None]]
"""`drawn_here` or `drawn_in_two`."""

_LEAST, _MOST = 4, 256  # figures from which a second process is worth its start, and whose numbers fit into a byte
_PATIENCE, _PATIENCE_S = 3.0, 5.0  # times the own time, and seconds: a second process that takes longer is ended


def encode_all(figures: Sequence[ReportFigure], dpi: int = DPI) -> dict[str, bytes]:
    """Name -> bytes of the file, of every figure; the same bytes as one by one."""
    known = {figure.name: figure.content for figure in figures if figure.content is not None and dpi == DPI}
    rest = [figure for figure in figures if figure.name not in known]
    rest.sort(key=lambda each: len(each.figure.axes), reverse=True)
    contents = _in_two([partial(figure.encode, dpi) for figure in rest])
    return {**known, **{figure.name: content for figure, content in zip(rest, contents, strict=True)}}


def drawn_here(drawings: Mapping[str, Drawing]) -> dict[str, ReportFigure | None]:
    """Figures of drawings under their names, as matplotlib has them."""
    return {name: drawing() for name, drawing in drawings.items()}


def drawn_in_two(drawings: Mapping[str, Drawing]) -> dict[str, ReportFigure | None]:
    """The same as finished files, for a page that shows them as they are; what takes longest should come first.

    Not only files are made by two processes then, but figures, too, which takes a third of the time. A finished figure
    is bytes alone: matplotlib's stays where it was drawn.
    """
    made = _in_two([partial(finished, drawing) for drawing in drawings.values()])
    return dict(zip(drawings, made, strict=True))


def finished(drawing: Drawing) -> ReportFigure | None:
    """A figure as the bytes of its file alone."""
    figure = drawing()
    return None if figure is None else replace(figure, figure=Figure(), content=figure.encode())


def _in_two(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Results of tasks in their order; where there may be a fork (`beside`), it takes some of them.

    Each process takes the next task when it has done one. What the fork doesn't send in time is done here.
    """
    if not _LEAST <= len(tasks) < _MOST or not may_fork():
        return [task() for task in tasks]
    numbers, told = os.pipe()
    os.write(told, bytes(range(len(tasks))))
    os.close(told)  # who finds the pipe empty is at the end of it
    context = get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(receiver, sender, numbers, tasks), daemon=True)
    process.start()
    sender.close()
    begun = time.perf_counter()
    done: dict[int, T] = {}
    try:
        for number in _taken(numbers):
            done[number] = tasks[number]()
        if receiver.poll(_PATIENCE_S + _PATIENCE * (time.perf_counter() - begun)):
            with suppress(EOFError):
                done |= receiver.recv()
    finally:
        receiver.close()
        os.close(numbers)
        process.kill()  # it has sent all, or never will
        process.join()
    return [done[number] if number in done else task() for number, task in enumerate(tasks)]


def _taken(numbers: int) -> Iterator[int]:
    """Numbers of tasks that nobody has taken yet."""
    while number := os.read(numbers, 1):
        yield number[0]


def _send(receiver: Connection, sender: Connection, numbers: int, tasks: Sequence[Callable[[], Any]]) -> None:
    receiver.close()  # else the fork of a process that was killed would wait for ever for itself to read
    with suppress(BrokenPipeError):
        sender.send({number: tasks[number]() for number in _taken(numbers)})
    sender.close()
