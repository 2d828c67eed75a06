"""Another engine of the same kind calibrated in from steady points, and what its own model leaves out made explicit."""
