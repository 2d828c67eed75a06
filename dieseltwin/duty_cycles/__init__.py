"""Driving: regulation schedules and random transients, and the engine inputs that follow through an ECU map."""
