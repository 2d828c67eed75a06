"""Short simulated segments that the tests of the estimators share."""

from __future__ import annotations

from segments import drive, idle_problem, problem, simulated

__all__ = ["drive", "idle_problem", "problem", "simulated"]
