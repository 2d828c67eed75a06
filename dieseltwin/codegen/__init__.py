"""Engines for others: C, functional mock-up units, tables of maps, networks as ONNX."""
