"""The single effect that leads, where nothing but its name and its size is asked.

Circumstances are looked for beside the best name, some times one after another, and what was learned of the maps is
then linearised about it. Each time all names are scored and refitted anew; what the others explained before is thrown
away. So where one of them surely leads to that, the others are followed no farther than to where they can't lead.
"""

from __future__ import annotations

from collections.abc import Sequence

from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.search.renewal import BENDS
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import OverRecordings

_SURELY = 2.0  # times the gain from which all are compared anew about the leading one
_IN_REACH = 0.5  # of the leading one's gain: what gains less under some circumstances leads under no others found next


def is_enough(found: Search, fits: Sequence[Fit]) -> bool:
    """Whether of some single effects, best first, the leading one is all that is asked: the others are compared anew
    about it, and no choice is made before."""
    twin, settings = found.twin, found.settings
    if belief_of(twin) is None or isinstance(twin, OverRecordings) or not fits:
        return False
    gain = found.gain(fits[0])
    return gain > _SURELY * BENDS and not settings.in_own_metrics(gain)


def contenders(found: Search) -> frozenset[str]:
    """Names of which one leads when little is changed."""
    least = _IN_REACH * found.gain(found.singles[0])
    return frozenset(name for fit in found.singles if found.gain(fit) >= least for name in fit.candidate.names)
