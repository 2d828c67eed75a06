"""The estimators of the core, one module each: what it is called, needs and reads, and its `estimate`."""
