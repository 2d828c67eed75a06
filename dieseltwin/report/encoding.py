"""Files of several figures at once: half of them in a process beside, as drawing takes one core for seconds."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection

from dieseltwin.engine.observations import SIMULATOR_THREADS, thread_count
from dieseltwin.report.style import ReportFigure

_LEAST = 4  # figures from which a second process is worth its start
_PATIENCE, _PATIENCE_S = 3.0, 5.0  # times the own half's time, and seconds: a second process that takes longer is ended


def encode_all(figures: Sequence[ReportFigure]) -> dict[str, bytes]:
    """Name -> bytes of the file, of every figure; the same bytes as one by one.

    A second process takes every other figure where a second core may be used (DIESELTWIN_THREADS, the process's own
    processors). It is a fork, so that nothing is imported or copied again. A fork inherits the locks that other
    threads hold (one that reads standard input holds it for ever), so a process with threads other than the
    simulator's, such as a server or a worker of the flows, doesn't fork. What the second process doesn't send in time
    is drawn here.
    """
    beside = figures[1::2] if len(figures) >= _LEAST and thread_count() > 1 and _may_fork() else []
    if not beside:
        return {figure.name: figure.encode() for figure in figures}
    context = get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, beside), daemon=True)
    process.start()
    sender.close()
    begun = time.perf_counter()
    encoded = {figure.name: figure.encode() for figure in figures[0::2]}
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
    return encoded | ({figure.name: figure.encode() for figure in beside} if sent is None else sent)


def _may_fork() -> bool:
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (threading.current_thread() is threading.main_thread() and "fork" in get_all_start_methods()
            and all(thread.name.startswith(SIMULATOR_THREADS) for thread in others))  # fmt: skip


def _send(sender: Connection, figures: Sequence[ReportFigure]) -> None:
    sender.send({figure.name: figure.encode() for figure in figures})
    sender.close()
