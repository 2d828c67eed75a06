"""The identification methods beside one another and beside the paper's printed numbers."""
