"""Files of several figures at once: half of the work in a process beside, as drawing takes one core for seconds."""

from __future__ import annotations

import time
from collections.abc import Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection

from dieseltwin.report.beside import may_fork
from dieseltwin.report.style import DPI, ReportFigure

_LEAST = 4  # figures from which a second process is worth its start
_PATIENCE, _PATIENCE_S = 3.0, 5.0  # times the own half's time, and seconds: a second process that takes longer is ended


def encode_all(figures: Sequence[ReportFigure], dpi: int = DPI) -> dict[str, bytes]:
    """Name -> bytes of the file, of every figure; the same bytes as one by one.

    A fork takes half of them where there may be one (`beside`). What it doesn't send in time is drawn here.
    """
    if len(figures) < _LEAST or not may_fork():
        return {figure.name: figure.encode(dpi) for figure in figures}
    here, beside = _halves(figures)
    context = get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, beside, dpi), daemon=True)
    process.start()
    sender.close()
    begun = time.perf_counter()
    encoded = {figure.name: figure.encode(dpi) for figure in here}
    patience = _PATIENCE_S + _PATIENCE * (time.perf_counter() - begun)
    sent: dict[str, bytes] | None = None
    try:
        sent = receiver.recv() if receiver.poll(patience) else None
    except EOFError:
        pass
    finally:
        receiver.close()
        process.kill()  # it has sent all, or never will
        process.join()
    return encoded | ({figure.name: figure.encode(dpi) for figure in beside} if sent is None else sent)


def _halves(figures: Sequence[ReportFigure]) -> tuple[list[ReportFigure], list[ReportFigure]]:
    """Two lists of figures that take about as long: the largest first, each to the list with fewer panels so far."""
    halves: tuple[list[ReportFigure], list[ReportFigure]] = ([], [])
    panels = [0, 0]
    for figure in sorted(figures, key=lambda each: len(each.figure.axes), reverse=True):
        lesser = panels.index(min(panels))
        halves[lesser].append(figure)
        panels[lesser] += 1 + len(figure.figure.axes)
    return halves


def _send(sender: Connection, figures: Sequence[ReportFigure], dpi: int) -> None:
    sender.send({figure.name: figure.encode(dpi) for figure in figures})
    sender.close()
