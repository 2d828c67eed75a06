"""few-shot-newton: states as combinations of learned bodies, and Gauss-Newton on their heads and the parameters."""
