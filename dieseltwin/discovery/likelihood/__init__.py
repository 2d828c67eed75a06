"""Noise, whitening, nuisances, linearisation, fits and scores: how well a twin explains a recording."""
