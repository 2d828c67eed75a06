"""The estimate of a run of Adam: the mean of its unknowns over the last epochs.

The paper says "after 30,000 epochs" and no more, so its estimate is presumably the last epoch's. The maps' dropout is
drawn anew in every epoch and moves A_vgtmax by 0.3-0.9 % from one epoch to the next, which a mean over the epochs of
the end takes away. `average_share` in `params.yaml` is the share of the epochs, chosen on validation driving; 0 is the
last epoch alone.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dieseltwin.identification.unknowns import to_physical


class TailMean:
    """Running mean of the unknowns in masked space, over the last share of the epochs.

    Args:
        epochs: updates of the whole run.
        share: share of the epochs that counts, from 0 (the state behind the last update alone) to 1.
        like: (L, 4) tensor whose shape is taken; the sum is in float64.
    """

    def __init__(self, epochs: int, share: float, like: Tensor) -> None:
        self.first = epochs - max(1, round(share * epochs)) + 1
        self.count = 0
        self.sum = torch.zeros_like(like, dtype=torch.float64)

    def add(self, epoch: int, masked: Tensor) -> None:
        """Count the unknowns (L, 4) behind `epoch` updates; epochs before the window are passed over."""
        if epoch >= self.first:
            self.sum += masked.detach()
            self.count += 1

    def physical(self) -> Tensor:
        """(L, 4) the mean [SI], masks and scalings undone."""
        return to_physical(self.sum / max(1, self.count), torch)
