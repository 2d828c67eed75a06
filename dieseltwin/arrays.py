"""The one name for what nearly every module handles: an array of numbers of double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
