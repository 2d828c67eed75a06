"""Baselines on the same cases: health parameters only, a Kalman filter with biases, a neural correction term."""

from dieseltwin.challenge.baselines.runs import BASELINES, baseline_rows, run_baselines, write_bands

__all__ = ["BASELINES", "baseline_rows", "run_baselines", "write_bands"]
