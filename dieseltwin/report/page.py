"""The one page of every machine: verdict, findings, laws, curves to look into, evidence, provenance; one file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dieseltwin.atomic import write_text
from dieseltwin.report import interactive, quantities, style
from dieseltwin.report.encoding import encode_all
from dieseltwin.report.interactive import Series
from dieseltwin.report.law_cards import LawCard
from dieseltwin.report.style import ReportFigure

COARSER_DPI = (85, 60)
DIESEL = "Wahlström and Eriksson (2011), with the effects that `dieseltwin effects` lists"


@dataclass(frozen=True)
class Table:
    """A table of text or markup.

    Attributes:
        heads: of its columns.
        rows: cells.
        words: numbers of the columns that hold words; numbers stand at the right.
        long: numbers of those among them that hold sentences.
        title, about: heading and a sentence above it; "" for none.
        folded: words of a fold that it hides in; "" shows it.
        grouped: a row whose first cell isn't empty begins a group.
        dense: in small letters.
    """

    heads: Sequence[str | Markup]
    rows: Sequence[Sequence[str | Markup]]
    words: tuple[int, ...] = (0,)
    long: tuple[int, ...] = ()
    title: str | Markup = ""
    about: str = ""
    folded: str = ""
    grouped: bool = False
    dense: bool = False

    def look(self, column: int) -> str:
        """Class of a column's cells."""
        names = ["name"] * (column in self.words) + ["wrap"] * (column in self.long)
        return " ".join(names)


@dataclass(frozen=True)
class Section:
    """One section of the page: anchor, heading, a sentence, curves to look into, figures, tables.

    `pictures` are finished ones, as `shown_figure` gives them.
    """

    id: str
    title: str
    figures: tuple[ReportFigure, ...] = ()
    words: str = ""
    series: Series | None = None
    tables: tuple[Table, ...] = ()
    pictures: tuple[Mapping[str, str], ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing to show in it."""
        shown = self.figures or self.pictures or self.series is not None
        return not (shown or any(table.rows for table in self.tables))

    @property
    def drawn(self) -> tuple[ReportFigure, ...]:
        """Its figures that are files as well."""
        own = () if self.series is None or self.series.drawn is None else (self.series.drawn,)
        return (*own, *self.figures)


@dataclass(frozen=True)
class Page:
    """What the page of a machine says.

    Attributes:
        title, about: heading, and what was judged.
        headline: the verdict as HTML; alarm: something is missing.
        findings: what was found, None where nothing was.
        cards: its laws.
        tables: of the summary, after the laws.
        sections: empty ones are left out.
        provenance, machine: what made it; and what differs from run to run.
        caution, note: as HTML, "" for none; the note says how to read the summary.
        source: of the model, for the last line.
        most_bytes: pictures are drawn more coarsely where the page would be larger.
    """

    title: str
    about: str
    headline: Markup
    alarm: bool
    findings: Table | None = None
    cards: Sequence[LawCard] = ()
    tables: Sequence[Table] = ()
    sections: Sequence[Section] = ()
    provenance: Sequence[tuple[str, str]] = ()
    machine: Sequence[tuple[str, str]] = field(default_factory=tuple)
    caution: Markup | str = ""
    note: Markup | str = ""
    source: str = DIESEL
    most_bytes: float = math.inf

    @property
    def summed(self) -> bool:
        """Whether there is a summary."""
        return bool(self.caution or self.note or self.findings or self.cards or self.tables)


def kept(*figures: ReportFigure | None) -> tuple[ReportFigure, ...]:
    """Those that there is data for."""
    return tuple(figure for figure in figures if figure is not None)


def kept_of(figures: Mapping[str, ReportFigure | None], *names: str) -> tuple[ReportFigure, ...]:
    """Those of the names that there is data for."""
    return kept(*(figures[name] for name in names))


def swatched(label: str, colour: str) -> Markup:
    """A label behind a patch of its colour."""
    return Markup('<span class="swatch" style="background:{}"></span>{}').format(colour, label)


def marked(text: str | Markup, kind: str) -> Markup:
    """A cell's text in a class of the page's style: none, better, worse, stopped."""
    return Markup('<span class="{}">{}</span>').format(kind, text)


def shown_figure(figure: ReportFigure, content: bytes) -> dict[str, str]:
    """A figure as the template takes it."""
    return {"name": figure.name, "title": figure.title, "caption": quantities.with_symbols(figure.caption),
            "uri": style.data_uri(content, figure.kind)}  # fmt: skip


def write_page(page: Page, out_html: str | Path, figures_dir: str | Path | None = None) -> Path:
    """Write a page atomically, and its figures as files beside it; returns the path of the page.

    Args:
        page: what it says.
        out_html: the file; its folder is made where missing.
        figures_dir: where to save the figures too; None for the page alone.
    """
    out = Path(out_html)
    sections = [section for section in page.sections if not section.empty]
    stills = {s.id: s.series.still for s in sections if s.series is not None}
    drawn = [figure for section in sections for figure in section.drawn]
    figures = list({figure.name: figure for figure in (*drawn, *stills.values())}.values())
    encoded = encode_all(figures)
    out.parent.mkdir(parents=True, exist_ok=True)
    if figures_dir is not None:
        for figure in drawn:
            figure.save(figures_dir, encoded[figure.name])
    text = _rendered(page, sections, stills, encoded)
    for dpi in COARSER_DPI:
        if len(text.encode("utf-8")) < page.most_bytes:
            break
        encoded |= encode_all([figure for figure in figures if figure.kind == "png"], dpi)
        text = _rendered(page, sections, stills, encoded)
    return write_text(out, text)


def _rendered(
    page: Page, sections: Sequence[Section], stills: Mapping[str, ReportFigure], encoded: Mapping[str, bytes]
) -> str:
    loader = PackageLoader("dieseltwin.report")
    templates = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    templates.filters["marked"] = quantities.with_symbols
    return templates.get_template("page.html.j2").render(
        page=page, sections=sections,
        stills={name: shown_figure(figure, encoded[figure.name]) for name, figure in stills.items()},
        pictures={s.id: [*s.pictures, *(shown_figure(f, encoded[f.name]) for f in s.figures)] for s in sections},
        script=interactive.script() if stills else "", look=interactive.look() if stills else "",
    )  # fmt: skip
