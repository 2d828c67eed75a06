"""The front door: plain functions over plain arguments, and their results. `import dieseltwin` hands them on.

Files, tables and objects of this package go in; what comes out is a `results.Result`. The command line, the tasks and
the benchmarks call the same functions.
"""
