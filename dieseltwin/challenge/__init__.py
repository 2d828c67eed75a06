"""The concealed benchmark: a plant of its own, sealed answers, a scorer and baselines (docs/benchmark.md)."""
