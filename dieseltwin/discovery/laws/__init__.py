"""Terms without a name and laws: features, grammar, screening, refits, ranking."""
