"""The one page of every machine: verdict, findings, laws, curves to look into, evidence, provenance; one file."""

from __future__ import annotations

from collections.abc import Sequence
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

EMPTY = "–"
DIESEL = "Wahlström and Eriksson (2011), with the effects that `dieseltwin effects` lists"


@dataclass(frozen=True)
class Table:
    """A table of text or markup.

    Attributes:
        heads: of its columns.
        rows: cells.
        words: numbers of the columns that hold words; numbers stand at the right.
        long: numbers of those among them that hold sentences.
    """

    heads: tuple[str | Markup, ...]
    rows: Sequence[tuple[str | Markup, ...]]
    words: tuple[int, ...] = (0,)
    long: tuple[int, ...] = ()

    def look(self, column: int) -> str:
        """Class of a column's cells."""
        names = ["name"] * (column in self.words) + ["wrap"] * (column in self.long)
        return " ".join(names)


@dataclass(frozen=True)
class Section:
    """One section of the page: anchor, heading, a sentence, curves to look into, figures, tables."""

    id: str
    title: str
    figures: tuple[ReportFigure, ...] = ()
    words: str = ""
    series: Series | None = None
    tables: tuple[Table, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing to show in it."""
        return not (self.figures or self.series is not None or any(table.rows for table in self.tables))

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
        caution: as HTML, "" for none.
        source: of the model, for the last line.
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
    source: str = DIESEL

    @property
    def summed(self) -> bool:
        """Whether there is a summary."""
        return bool(self.caution or self.findings or self.cards or self.tables)


def templates() -> Environment:
    """The templates of pages."""
    loader = PackageLoader("dieseltwin.report")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)


def shown_figure(figure: ReportFigure, content: bytes) -> dict[str, str]:
    """A figure as the templates take it."""
    return {"name": figure.name, "title": figure.title, "caption": Markup(quantities.with_symbols(figure.caption)),
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
    encoded = encode_all(list({figure.name: figure for figure in (*drawn, *stills.values())}.values()))
    out.parent.mkdir(parents=True, exist_ok=True)
    if figures_dir is not None:
        for figure in drawn:
            figure.save(figures_dir, encoded[figure.name])
    shown = {name: shown_figure(figure, encoded[figure.name]) for name, figure in stills.items()}
    text = templates().get_template("page.html.j2").render(
        page=page, sections=sections, stills=shown,
        pictures={s.id: [shown_figure(f, encoded[f.name]) for f in s.figures] for s in sections},
        script=interactive.script() if stills else "", look=interactive.look() if stills else "",
    )  # fmt: skip
    return write_text(out, text)
