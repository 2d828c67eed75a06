"""Files of several figures at once: half of them in a process beside, as drawing takes one core for seconds."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection

from dieseltwin.engine.observations import thread_count
from dieseltwin.report.style import ReportFigure

_LEAST = 4  # figures from which a second process is worth its start


def encode_all(figures: Sequence[ReportFigure]) -> dict[str, bytes]:
    """Name -> bytes of the file, of every figure; the same bytes as one by one.

    A second process takes every other figure where a second core may be used (DIESELTWIN_THREADS, the process's own
    processors). It is a fork, so that nothing is imported or copied again; a process with several threads that do
    something, such as a server, doesn't fork. What the second process doesn't send is drawn here.
    """
    beside = figures[1::2] if len(figures) >= _LEAST and thread_count() > 1 and _may_fork() else []
    if not beside:
        return {figure.name: figure.encode() for figure in figures}
    context = get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, beside), daemon=True)
    process.start()
    sender.close()
    encoded = {figure.name: figure.encode() for figure in figures[0::2]}
    try:
        encoded |= receiver.recv()
    except EOFError:
        encoded |= {figure.name: figure.encode() for figure in beside}
    finally:
        receiver.close()
        process.join()
    return encoded


def _may_fork() -> bool:
    return threading.current_thread() is threading.main_thread() and "fork" in get_all_start_methods()


def _send(sender: Connection, figures: Sequence[ReportFigure]) -> None:
    sender.send({figure.name: figure.encode() for figure in figures})
    sender.close()
