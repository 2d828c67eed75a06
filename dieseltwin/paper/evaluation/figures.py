"""Figures that the evaluation has and the report of one recording has not."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from dieseltwin.paper.evaluation import words as words
from dieseltwin.report import quantities, style
from dieseltwin.report.results import PARAMETERS

WIDTH_IN = 11.0
_LINES = ("-", "--", ":", "-.")


@style.styled
def ratios_figure(beside: pd.DataFrame) -> style.ReportFigure:
    """Our RMSE over the paper's in every cell, by parameter and method; open marks: bound above 10 %, not scored."""
    pairs = list(beside.groupby(["table", "method"], sort=True))
    figure = Figure(figsize=(WIDTH_IN, 1.1 + 0.55 * len(pairs)))
    panels = figure.subplots(1, len(PARAMETERS), sharey=True, sharex=True)
    for axes, parameter in zip(panels, PARAMETERS, strict=True):
        for row, ((_, method), whole) in enumerate(pairs):
            look = style.method_style(str(method))
            part = whole[(whole["parameter"] == parameter) & np.isfinite(whole["ratio"])]
            for scored in (True, False):
                dots = part[(part["bound_class"] == "scored") == scored]
                places = row + np.linspace(-0.25, 0.25, max(2, len(dots)))[: len(dots)]
                axes.scatter(
                    dots["ratio"], places, s=18, marker=look.marker, linewidths=0.9, edgecolors=look.colour,
                    facecolors=look.colour if scored else "none", alpha=0.85,
                )  # fmt: skip
        axes.axvline(1.0, color=style.TRUTH, linewidth=1.0, linestyle="--")
        axes.set_xscale("log")
        axes.set_title(quantities.symbol(parameter))
        axes.set_xlabel("our RMSE / paper's")
    labels = [f"{style.method_style(str(m)).label}\n{'multi-stage' if 'transfer_learning' in t else 'few-shot'} table"
              for (t, m), _ in pairs]  # fmt: skip
    panels[0].set_yticks(range(len(pairs)), labels)
    return style.ReportFigure("rmse_ratios", "Our error over the paper's, cell by cell", words.RATIOS, figure)


@style.styled
def over_epochs_figure(table: pd.DataFrame) -> style.ReportFigure:
    """RMSE of each parameter along the epochs, one line for each method and variant."""
    figure = Figure(figsize=(WIDTH_IN, 5.2))
    panels = figure.subplots(2, 2, sharex=False).ravel()
    named = table.assign(variant=table["variant"].fillna(""))
    variants = sorted(named["variant"].unique())
    for axes, parameter in zip(panels, PARAMETERS, strict=True):
        for (method, variant), part in named[named["parameter"] == parameter].groupby(["method", "variant"], sort=True):
            look = style.method_style(str(method))
            line = _LINES[variants.index(variant) % len(_LINES)]
            label = look.label + (f", {variant}" if variant else "")
            axes.plot(part["epoch"], 100.0 * part["rmse"], color=look.colour, linestyle=line, label=label)
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
        axes.set_ylabel(f"RMSE of {quantities.symbol(parameter)} [%]")
        axes.set_xlabel("epoch")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(4, max(1, len(labels))))
    return style.ReportFigure("over_epochs", "Error along the training, noisy data", words.OVER_EPOCHS, figure)
