"""Figures, tables and the self-contained HTML reports, built from stored results.

Nothing is imported here: a page of one kind shall not load the drawings of the others.
"""
