"""Recordings: reader, channel maps, plausibility, noise, steady points, data sets, public recordings."""
