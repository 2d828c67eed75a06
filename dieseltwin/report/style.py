"""One look for every figure of the report: fonts, colours, line styles, file encoding.

The palette is Okabe and Ito's (distinguishable with the common colour-vision deficiencies); each method keeps one
colour, one marker and one line style in every figure, so that a print in grey can still be read.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import Bbox
from PIL import Image

from dieseltwin.atomic import write_bytes
from dieseltwin.report.ticks import ticks_known
from dieseltwin.settings.methods import MethodStyle, known

TRUTH = "#000000"
MEASURED = "#8a8a8a"
BEFORE = "#D55E00"
"""What is wrong or was before a repair; alarms."""
AFTER = "#0072B2"
LIGHT = "#8CC3E8"  # of the same hue
PAPER = "#b8b8b8"
GRID = "#dcdcdc"
PALETTE_COLOURS = 255
NOT_IDENTIFIABLE = "#efefef"
BLIND: dict[str, Any] = {"facecolor": NOT_IDENTIFIABLE, "edgecolor": "#cfcfcf", "hatch": "///", "linewidth": 0}
"""Where a parameter cannot be known: keywords of a patch."""
BAND_OF_TRUTH = "#e4e4e4"
SEGMENT_LINE = "#9a9a9a"

RC: dict[str, object] = {
    "font.family": "DejaVu Sans",  # ships with matplotlib: the same letters on every machine
    "font.size": 10.5,
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.constrained_layout.use": True,
    "hatch.linewidth": 0.6,
    "svg.hashsalt": "dieseltwin",  # element ids without randomness: the same figure gives the same bytes
    "svg.fonttype": "path",
    "path.simplify_threshold": 0.5,
}

DPI = 110
"""Dots an inch of pictures of time series."""


def slug(name: str) -> str:
    """A name as part of a file's name: letters and digits, the rest underscores."""
    return "".join(c if c.isalnum() else "_" for c in name)


P = ParamSpec("P")
R = TypeVar("R")


_SPARE_COLOURS = ("#56B4E9", "#7a5195", "#b8860b", "#5c5c5c")
_SPARE_MARKERS = ("P", "X", "<", ">")


def method_style(method: str) -> MethodStyle:
    """The style of ``method``; one that this version doesn't know gets a spare colour that depends on its name only."""
    found = known(method)
    if found is not None:
        return found.style
    number = sum(method.encode()) % len(_SPARE_COLOURS)
    return MethodStyle(_SPARE_COLOURS[number], _SPARE_MARKERS[number], "-", method)


def styled(function: Callable[P, R]) -> Callable[P, R]:
    """Run a drawing function under the report's look without changing the caller's matplotlib settings."""

    @wraps(function)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        with mpl.rc_context(RC):
            return function(*args, **kwargs)

    return drawn


def load() -> None:
    """Have fonts and the reader of formulae at hand before the first figure wants them, a quarter of a second."""
    with mpl.rc_context(RC):
        figure = Figure(figsize=(2.0, 2.0))
        figure.subplots().set_title("$x_1$ x")
        ReportFigure("", "", "", figure).encode()


def plain_text(text: str) -> str:
    """Somebody else's text for a figure: dollar signs are no mathematics, and it ends after 80 letters."""
    return text[:80].replace("$", r"\$")


def grid_of_panels(
    figure: Figure, rows: int, columns: int, margins: tuple[float, float, float, float], gaps: tuple[float, float],
    **options: Any,
) -> Any:  # fmt: skip
    """Panels (rows, columns) at places that are known beforehand: twenty measured ones take a second to lay out.

    Args:
        margins: left, right, bottom and top of the figure [in]; gaps: between columns and between rows [in].
        options: of `Figure.subplots`.
    """
    left, right, bottom, top = margins
    wide, high = figure.get_size_inches()
    width = (wide - left - right - (columns - 1) * gaps[0]) / columns
    height = (high - bottom - top - (rows - 1) * gaps[1]) / rows
    places = {"left": left / wide, "bottom": bottom / high, "right": 1.0 - right / wide, "top": 1.0 - top / high,
              "wspace": gaps[0] / width, "hspace": gaps[1] / height}
    figure.set_layout_engine("none")
    return figure.subplots(rows, columns, squeeze=False, gridspec_kw=places, **options)


def note(axes: Axes, text: str) -> None:
    """Write ``text`` into the middle of an empty panel: a panel without data says so instead of staying blank."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#555555", wrap=True)


@dataclass(frozen=True)
class ReportFigure:
    """One figure of the report with the words that belong to it.

    ``kind`` is ``"svg"`` for charts and ``"png"`` for long time series, whose paths would make an SVG heavy.
    ``content`` is its file at `DPI` where another process drew it, which keeps the ``figure``.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    kind: str = "svg"
    content: bytes | None = field(default=None, repr=False)

    def encode(self, dpi: int = DPI) -> bytes:
        """Return the file's bytes; the same figure gives the same bytes (no date, no random ids)."""
        if self.content is not None:
            if dpi != DPI:
                raise ValueError(f"{self.name} was drawn in another process, at {DPI} dots an inch")
            return self.content
        with mpl.rc_context(RC), ticks_known(self.figure):
            if self.kind == "png":
                return _png(self.figure, dpi)
            return _svg(self.figure)

    def save(self, directory: str | Path, content: bytes | None = None) -> Path:
        """Write ``<directory>/<name>.<kind>`` atomically and return its path.

        ``content``: its bytes, where they are at hand; None draws it.
        """
        Path(directory).mkdir(parents=True, exist_ok=True)
        return write_bytes(Path(directory) / f"{self.name}.{self.kind}", self.encode() if content is None else content)


def _lay_out(figure: Figure) -> None:
    """Place a figure's panels once and for all, each of them measured once.

    Matplotlib measures every panel a second time, where it was just placed, in case its labels have become others; that
    is a third of a picture's seconds. What labels take beside a panel is taken as it was measured first.
    """
    layout = figure.get_layout_engine()
    if isinstance(layout, ConstrainedLayoutEngine):
        for axes in figure.axes:
            axes.get_tightbbox = _measured_once(axes)  # type: ignore[method-assign]
        layout.execute(figure)
        for axes in figure.axes:
            del axes.get_tightbbox  # type: ignore[method-assign]
    figure.set_layout_engine("none")


def _measured_once(axes: Axes) -> Callable[..., Bbox | None]:
    measure, found = axes.get_tightbbox, list[tuple[Bbox, Bbox] | None]()

    def get_tightbbox(*args: Any, **options: Any) -> Bbox | None:
        place = axes.get_window_extent().frozen()
        if not found:
            bounds = measure(*args, **options)
            found.append(None if bounds is None else (place, Bbox(bounds.get_points())))
            return bounds
        if found[0] is None:
            return None
        was, bounds = found[0]
        return Bbox(place.get_points() + bounds.get_points() - was.get_points())

    return get_tightbbox


def _svg(figure: Figure) -> bytes:
    """An SVG, laid out once and drawn once: `savefig` would draw it all once more in case its layout changes."""
    dpi = figure.dpi
    _lay_out(figure)
    buffer = io.BytesIO()
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    figure.set_dpi(dpi)
    return buffer.getvalue()


def _png(figure: Figure, dpi: int) -> bytes:
    """A PNG with a palette: a third of the size, and no difference that an eye finds in a line drawing."""
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    _lay_out(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    buffer = io.BytesIO()
    palette = picture.quantize(PALETTE_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    palette.save(buffer, format="png", compress_level=6)
    return buffer.getvalue()


def data_uri(content: bytes, kind: str) -> str:
    """Return ``content`` of an SVG or PNG file as a data URI, so that the page loads nothing."""
    media = "image/svg+xml" if kind == "svg" else "image/png"
    return f"data:{media};base64,{base64.b64encode(content).decode('ascii')}"


def legend_above(figure: Figure, handles: Sequence[Artist], width_in: float) -> None:
    """A figure's legend above its panels: one row where it fits into the width [in], else as few as do."""
    labels = [str(handle.get_label()) for handle in handles]
    figure.legend(handles=list(handles), loc="outside upper center", ncols=_columns(labels, width_in))


def _columns(labels: Sequence[str], width_in: float) -> int:
    wide = [0.5 + 0.083 * len(label) for label in labels]  # handle and gaps, then a letter at the house's size
    for rows in range(1, len(wide) + 1):
        columns = math.ceil(len(wide) / rows)
        if sum(max(wide[i * rows : (i + 1) * rows], default=0.0) for i in range(columns)) <= width_in:
            return columns
    return 1
