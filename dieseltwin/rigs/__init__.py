"""Machines that are no engines, declared in a file: their equations, what may be missing, and what was found."""
