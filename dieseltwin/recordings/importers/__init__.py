"""Importers, one file a format: what a file holds, in its own names, units and rasters. Use `read.read_raw`."""
