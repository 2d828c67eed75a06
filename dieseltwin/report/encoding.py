"""Files of several figures at once: half of them in a process beside, as drawing takes one core for seconds."""

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

    A fork takes every other figure where there may be one (`beside`). What it doesn't send in time is drawn here.
    """
    beside = figures[1::2] if len(figures) >= _LEAST and may_fork() else []
    if not beside:
        return {figure.name: figure.encode(dpi) for figure in figures}
    context = get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, beside, dpi), daemon=True)
    process.start()
    sender.close()
    begun = time.perf_counter()
    encoded = {figure.name: figure.encode(dpi) for figure in figures[0::2]}
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


def _send(sender: Connection, figures: Sequence[ReportFigure], dpi: int) -> None:
    sender.send({figure.name: figure.encode(dpi) for figure in figures})
    sender.close()
