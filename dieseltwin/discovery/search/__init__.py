"""The search: health-only fit, scores, refits of every explanation, onset and region, and the choice."""
