"""Bad inputs through the command line: `python -m benchmarks.bad_inputs`."""
