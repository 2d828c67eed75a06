"""What the search of a rig finds, round by round."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.options import SearchOptions
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.rigs.fitting import checked_rows, rms_left, times_noise
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.twin import When
from dieseltwin.settings.defaults import default_search
from dieseltwin.settings.search import RigSettings

LOUD = 3.0
"""Times the noise, by which a repaired machine may miss a reading without a word."""


@dataclass(frozen=True, kw_only=True)
class Options(SearchOptions):
    """What a user may choose.

    Attributes:
        law_search: look for a law where no name fits.
    """

    law_search: bool = True
    search: RigSettings = field(default_factory=lambda: default_search().rigs)


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Attributes:
        found: the search.
        names: what it would add.
        law: or the law.
        before, after: rms error of free runs over the last part of the recording, by machines that were fitted to the
            first part, (C,) [units of the readings]; NaN for a reading that is absent there.
        taken: whether they are good enough.
        early: the machine of `after`; None where it runs away, and where there was nothing to try.
        when: it is so [time stamps, s]; None: from the first row on.
    """

    found: Search
    names: tuple[str, ...]
    law: Law | None
    before: Array
    after: Array
    taken: bool
    early: RigParameters | None = None
    when: When | None = None


@dataclass(frozen=True)
class Course:
    """Rounds one after another: the machine that they lead to, its fit, and that of before fitted to the first part."""

    rounds: tuple[Round, ...]
    machine: RigParameters
    fit: Linearisation
    early: RigParameters | None = None

    @property
    def finds(self) -> bool:
        """Whether anything was taken."""
        return any(item.taken for item in self.rounds)

    @property
    def is_loud(self) -> bool:
        """Whether a reading is missed by more than noise, in the fit or in free runs that none has seen, as they are
        with all that was taken."""
        foretold = [item.after for item in self.rounds if item.taken]
        left = np.stack([rms_left(self.fit), *foretold[-1:]])
        return bool((times_noise(self.fit, left) > LOUD).any())

    @property
    def silent(self) -> bool:
        """Whether nothing is missing."""
        return not self.finds and self.rounds[-1].found.kind == "healthy"


@dataclass(frozen=True)
class RigDiscovery:
    """What a rig's file leaves out.

    Attributes:
        recording, options: as asked.
        before, repaired: the machine fitted to the recording, without and with what was found.
        fit_before, fit_after: of their windows.
        fit_otherwise: as `fit_before`, with the inputs taken the other way between rows; None where that runs away.
        rounds: of the search; the last one took nothing, or most were named.
        seconds: wall time.
        early: the machine without what was found, fitted to the first part; None where it runs away, and where there
            was nothing to try.
    """

    recording: RigRecording
    options: Options
    before: RigParameters
    repaired: RigParameters
    fit_before: Linearisation
    fit_after: Linearisation
    fit_otherwise: Linearisation | None
    rounds: tuple[Round, ...]
    seconds: float
    early: RigParameters | None = None

    @property
    def taken(self) -> tuple[Round, ...]:
        """Rounds whose finding is part of the repaired machine."""
        return tuple(item for item in self.rounds if item.taken)

    @property
    def when(self) -> When | None:
        """When the first finding is so [time stamps, s]; None: from the first row on, and where there is none."""
        return self.rounds[0].when if self.taken else None

    @property
    def begun(self) -> tuple[str, ...]:
        """Names of what is so then only; none where all is so from the first row on, and of one law among several."""
        if self.when is None:
            return ()
        laws = sum(item.law is not None for item in self.taken)
        return (NONE_OF_THESE,) * (laws == 1) if self.rounds[0].law is not None else self.rounds[0].names

    @property
    def checked(self) -> slice:
        """The rows that judged what was found."""
        return checked_rows(self.recording, self.options.search.checked_share, onset_of(self.when))

    @property
    def more_is_missing(self) -> bool:
        """Whether the last round saw something that has no name and no law that foretells."""
        last = self.rounds[-1]
        return not last.taken and last.found.kind != "healthy"


def onset_of(when: When | None) -> float | None:
    """When something begins; None: from the first row on."""
    return None if when is None else when.onset_s
