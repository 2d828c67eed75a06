"""A channel that became late makes every balance jump in transients, and seconds that jump weigh less.

So where nothing was found, clocks are tried once by a likelihood that weighs no second down by its neighbours
(Student's t about the scatter that was learned). A clock that explains much there is looked for again with seconds
weighed beside it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.petrol.effects import CLOCKS
from dieseltwin.petrol.maps import FREEDOM
from dieseltwin.petrol.twin import PetrolTwin

TRIED = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)  # delays [tolerances of the clock]


def late_channel(found: Search, withhold: Collection[str] = ()) -> Mapping[str, Array] | None:
    """The clock that explains most, with its size over time (n,); None where none is an alarm by itself.

    Args:
        found: a search that found nothing.
        withhold: effects to do without.
    """
    twin = found.twin
    if not isinstance(twin, PetrolTwin):
        return None
    scales, factor = twin.robust_scales()
    healthy = found.null.simulated

    def evidence(expected: Array) -> Array:
        """(n,) twice the log-likelihood of each second."""
        misfit = twin.plain - healthy - expected
        each = -(FREEDOM + 1.0) * np.log1p(misfit**2 / (FREEDOM * scales**2)) / factor
        return np.asarray(each.sum(axis=1))

    none = np.zeros(len(twin.time_s))
    plain = twin.expected_with({})
    before = evidence(np.zeros_like(plain))
    best, strongest = found.settings.hidden_gain, None
    for name in CLOCKS:
        for times in TRIED if name in twin.hypotheses and name not in withhold else ():
            size = times * twin.hypotheses[name].tolerance
            gains = evidence(twin.expected_with({name: none + size}) - plain) - before
            since = np.cumsum(gains[::-1])[::-1][twin.starts]
            first = int(since.argmax())
            if since[first] > best:
                acts = np.arange(len(none)) >= twin.starts[first]
                best, strongest = float(since[first]), {name: size * acts}
    return strongest
