"""What a user sees while the chain runs: one bar a running step, with an estimate of the time left.

A step that reports its progress is extrapolated; one that doesn't is judged by how long it took last time (kept in
``.cache/expected_seconds.json``) or by the estimate that stands at its definition. Without a terminal each step is two
plain lines.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

# Below this fraction the extrapolation of a reported progress is worth less than last time's duration.
_TRUSTED_FRACTION = 0.05


_PIPE_WIDTH = 140


class TimeLeft(ProgressColumn):
    """Estimated seconds left, from the task's own fields."""

    def render(self, task: Task) -> Text:
        """``about 1:05 left``, or nothing where there is no estimate."""
        left = task.fields.get("left_s")
        if left is None or task.finished:
            return Text(task.fields.get("note", ""), style="dim")
        return Text(f"about {_clock(left)} left", style="cyan")


@dataclass
class _Bar:
    """One running step."""

    started: float
    expected_s: float
    fraction: float = 0.0
    task_id: object = None

    def estimate(self, now: float) -> tuple[float, float]:
        """(fraction done, seconds left)."""
        elapsed = now - self.started
        if self.fraction > _TRUSTED_FRACTION:
            return self.fraction, elapsed * (1.0 - self.fraction) / self.fraction
        left = max(self.expected_s - elapsed, 1.0)
        return elapsed / (elapsed + left), left


@dataclass
class Display:
    """Progress of the steps of one run. Thread-safe: steps run in threads."""

    history: Path
    console: Console = field(default_factory=lambda: _console())
    _bars: dict[str, _Bar] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _live: Progress | None = None
    _stop: threading.Event = field(default_factory=threading.Event)

    @contextmanager
    def showing(self) -> Iterator[None]:
        """Draw bars inside the block (terminals only)."""
        if self._live is not None or not self.console.is_terminal:
            yield
            return
        live = Progress(
            SpinnerColumn(),
            TextColumn("{task.description:<44}"),
            BarColumn(bar_width=28),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TimeLeft(),
            console=self.console,
            transient=True,
        )
        self._live, self._stop = live, threading.Event()
        ticker = threading.Thread(target=self._tick, daemon=True)
        try:
            with live:
                ticker.start()
                yield
        finally:
            self._stop.set()
            ticker.join(timeout=2.0)
            self._live = None

    def start(self, step: str, expected_s: float, label: str = "") -> None:
        """A step begins; ``expected_s``: its estimate where it never ran here."""
        expected_s = self._history().get(step, expected_s)
        bar = _Bar(time.monotonic(), expected_s)
        with self._lock:
            if self._live is not None:
                bar.task_id = self._live.add_task(label or step, total=1.0, left_s=expected_s, note="")
            self._bars[step] = bar
        if self._live is None:
            self.console.print(f"  {label or step}: started, about {_clock(expected_s)}")

    def update(self, step: str, fraction: float) -> None:
        """A step reports the fraction done."""
        bar = self._bars.get(step)
        if bar is not None:
            bar.fraction = fraction

    def finish(self, step: str, label: str = "") -> None:
        """A step ended well; remembers how long it took."""
        with self._lock:
            bar = self._bars.pop(step, None)
        seconds = time.monotonic() - bar.started if bar else 0.0
        if bar and self._live is not None:
            self._live.remove_task(bar.task_id)  # type: ignore[arg-type]
        self._remember(step, seconds)
        self.console.print(f"[green]✓[/] {label or step:<44} {seconds:7.1f} s")

    def elsewhere(self, step: str, label: str, seconds: float) -> None:
        """A step ended well in another process that shows nothing; remembers how long it took."""
        self._remember(step, seconds)
        self.console.print(f"[green]✓[/] {label:<44} {seconds:7.1f} s")

    def cached(self, label: str) -> None:
        """A step's result was there already."""
        self.console.print(f"[green]✓[/] {label:<44} [dim]already computed[/]")

    def fail(self, step: str) -> None:
        """A step ended badly."""
        with self._lock:
            bar = self._bars.pop(step, None)
        if bar and self._live is not None:
            self._live.remove_task(bar.task_id)  # type: ignore[arg-type]

    def say(self, text: RenderableType) -> None:
        """A line of text or a table above the bars."""
        self.console.print(text)

    def _tick(self) -> None:
        while not self._stop.wait(0.5):
            now = time.monotonic()
            with self._lock:
                for bar in self._bars.values():
                    fraction, left = bar.estimate(now)
                    if self._live is not None and bar.task_id is not None:
                        self._live.update(bar.task_id, completed=fraction, left_s=left)  # type: ignore[arg-type]

    def _history(self) -> dict[str, float]:
        try:
            return {str(step): float(s) for step, s in json.loads(self.history.read_text()).items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def _remember(self, step: str, seconds: float) -> None:
        with self._lock:
            history = self._history() | {step: round(seconds, 1)}
            self.history.parent.mkdir(parents=True, exist_ok=True)
            partial = self.history.with_name(f"{self.history.name}.{os.getpid()}.partial")
            partial.write_text(json.dumps(history, indent=1, sort_keys=True))
            partial.replace(self.history)


def _console() -> Console:
    """The terminal; a pipe or file has no width, lines stay whole there."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=_PIPE_WIDTH)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
