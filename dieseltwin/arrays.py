"""What nearly every module handles: an array of numbers of double precision, and a robust measure of its scatter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAD_TO_STD = 1.482602218505602
"""Standard deviation over median absolute deviation, of a Gaussian: scatter that few far readings don't set."""
