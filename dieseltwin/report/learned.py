"""What was learned of an engine's maps."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dieseltwin.report import style

BELIEVED, CORRECTED, LEFT = "#b8b8b8", style.AFTER, style.BEFORE


@style.styled
def corrections(maps: pd.DataFrame) -> style.ReportFigure | None:
    """Belief before, correction and what is left unknown [%], a group of bars for each map; None without a map.

    Args:
        maps: one row a map, columns believed_pct, corrected_pct, known_to_pct.
    """
    if maps.empty:
        return None
    figure = Figure(figsize=(9.0, 3.4))
    axes = figure.subplots()
    places = np.arange(len(maps))
    bars = (("believed_pct", BELIEVED, "believed before"), ("corrected_pct", CORRECTED, "corrected by"),
            ("known_to_pct", LEFT, "known to"))  # fmt: skip
    for k, (column, colour, label) in enumerate(bars):
        axes.bar(places + 0.27 * (k - 1), maps[column], width=0.25, color=colour, label=label)
    axes.set_xticks(places, [str(name) for name in maps.index])
    axes.set_ylabel("rms [%]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    caption = "Relative errors of the maps where they became known: believed before, corrected by, known to."
    return style.ReportFigure("maps", "Learned maps", caption, figure)
