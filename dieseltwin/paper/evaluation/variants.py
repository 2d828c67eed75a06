"""What one changed thing does to the score: every variant against the paper's tables."""

from __future__ import annotations

import pandas as pd

from dieseltwin.paper.evaluation.tables import beside_paper, score_of

COLUMNS = ("variant", "method", "table", "case", "cells", "better", "ratio")


def variant_scores(table: pd.DataFrame) -> pd.DataFrame:
    """Score of each variant, and of the unchanged ensembles of the same methods and cases, over the scored cells.

    Args:
        table: of `evaluation.cells`.

    Returns:
        Columns variant ("" for the unchanged), method, table, case, cells, better (share with an RMSE of at most the
        paper's), ratio (geometric mean of our RMSE over the paper's). A variant of multi-stage takes the first minute
        from the variant of baseline of the same name, and has none where there is no such variant.
    """
    named = table.assign(variant=table["variant"].fillna(""))
    rows = []
    changed: set[tuple[str, str]] = set()
    for variant in [*sorted(set(named["variant"]) - {""}), ""]:
        of = beside_paper(named[named["variant"] == variant].assign(variant=""))
        for (method, printed, case), part in of.groupby(["method", "table", "case"], sort=True):
            scored = part[part["bound_class"] == "scored"]
            if scored.empty or (not variant and (method, case) not in changed):
                continue
            changed.add((method, case))
            named_by = {"variant": variant, "method": method, "table": printed, "case": case}
            rows.append({**named_by, **score_of(scored)})
    return pd.DataFrame(rows, columns=list(COLUMNS)).sort_values(list(COLUMNS[1:4]), kind="stable", ignore_index=True)
