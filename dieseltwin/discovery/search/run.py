"""The search: health-only fit, scores, refits of every competitive explanation, and the choice among them.

Works on any `Twin`. Gains are decreases of -2 log marginal likelihood over the health-only fit (docs/discovery.md).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from dieseltwin.discovery.likelihood.fit import Fit, Linearisation
from dieseltwin.discovery.search.alarms import (
    clearly_named,
    hidden_bar,
    raises_alarm,
    score_terms,
    score_unnamed,
    shown_by_simulation,
    shown_in_part,
)
from dieseltwin.discovery.search.circumstances import same_circumstances
from dieseltwin.discovery.search.dating import date_edges
from dieseltwin.discovery.search.explanations import (
    choose,
    choose_so_far,
    pair_bar,
    pair_beats_single,
    single_stands,
    try_more_pairs,
    try_pairs,
)
from dieseltwin.discovery.search.nameless import look_for_law
from dieseltwin.discovery.search.preparation import (
    prepare,
    recentred,
)
from dieseltwin.discovery.search.quick_inputs import ahead_of, is_made_again, likelier, with_inputs_between_rows
from dieseltwin.discovery.search.renewal import about_the_leader
from dieseltwin.discovery.search.singles import about_leading_name, with_names, with_singles
from dieseltwin.discovery.search.slopes import refit_by_slopes
from dieseltwin.discovery.search.standing import explain_standing
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variant_fits import scan_all, try_variants
from dieseltwin.discovery.search.weather import (
    cost_of_weather,
    in_assumed_weather,
    in_weather_of,
    is_guessed,
    weather_is_settled,
    with_reading_in_time,
)
from dieseltwin.discovery.time_limit import OutOfTimeError, time_limit
from dieseltwin.discovery.twins.interface import OverRecordings, Twin
from dieseltwin.settings.search import SearchSettings

STAGES = ("terms without a name", "onsets and regions", "two effects", "a law")
"""What is looked at behind single effects, in this order."""

_WEATHERS = 3  # in which a name is tried that isn't enough in that of before
_FAR_BEHIND = 100.0  # -2 log likelihood that further rounds of weather don't make good
_NEAR_ALARM = 0.5  # of an alarm's gain: from there on a name is looked at in the weather that it asks for
_WITHIN = 1.25  # times the name's gain: what explains more than that isn't the weather's doing


def run(
    twin: Twin, settings: SearchSettings, *, laws: bool = True, time_s: float | None = None, starts: Sequence[Fit] = ()
) -> Search:
    """The whole search.

    Args:
        twin: bound to its recording.
        settings: thresholds.
        laws, time_s, starts: as of `carry_on`, the limit from here on.
    """
    began = time.perf_counter()
    found = prepare(twin, settings)
    left = None if time_s is None else time_s - (time.perf_counter() - began)
    return carry_on(found, laws=laws, time_s=left, starts=starts)


def carry_on(
    found: Search, *, laws: bool = True, time_s: float | None = None, starts: Sequence[Fit] = ()
) -> Search:
    """The search from where `prepare` leaves it, which is used up by it.

    Args:
        found: as `prepare` made it.
        laws: look for a law where no name fits.
        time_s: after so many seconds the best answer so far is given; the refits of single effects are always
            finished. None: no limit.
        starts: fits of single effects that lie near their minima, where that is far from the fit without any.
    """
    if found.standing:
        explain_standing(found)
        return found
    began = time.perf_counter()
    found = with_names(found, starts)
    left = None if time_s is None else time_s - (time.perf_counter() - began)
    try:
        with time_limit(left):
            _explain(found, in_full=time_s is not None)
            if time_s is not None or not is_made_again(found):  # what it leaves without a law says so already
                if found.kind == "law" and refit_by_slopes(found):
                    _explain(found, in_full=time_s is not None)
                found = _in_own_weather_in_time(found)
                if found.kind == "law" and laws:
                    found = _with_law(found)
                    found = _with_reading_in_time(found)
    except OutOfTimeError:
        found.unfinished = STAGES[STAGES.index(found.stage) :]
        if found.kind != "law" and (found.kind != "healthy" or raises_alarm(found, found.singles[0])):
            choose_so_far(found)
    found.earlier = []
    if not found.unfinished and found.twin.states:  # without states there are choices of the machine's own behind this
        date_edges(found)
    return _with_inputs_between_rows(found, laws, None if time_s is None else time_s - (time.perf_counter() - began))


def _with_inputs_between_rows(found: Search, laws: bool, time_s: float | None) -> Search:
    """The search where inputs may have moved between the rows, where that explains more or the noise can't be as large
    as without; arguments as of `carry_on`."""
    if found.unfinished or found.kind == "healthy":
        return found
    other, stands = with_inputs_between_rows(found)
    if other is None or (time_s is not None and time_s <= 0.0):
        return found
    clock = time.perf_counter()
    here = prepare(other, found.settings)
    left = None if time_s is None else time_s - (time.perf_counter() - clock)
    here = carry_on(here, laws=laws, time_s=left)
    return here if stands else likelier(found, here)


def _in_own_weather_in_time(found: Search) -> Search:
    """The same as `_in_own_weather`; where time is over, what was found before, if that was an answer."""
    try:
        return _in_own_weather(found)
    except OutOfTimeError:
        if found.kind == "law":
            raise
        return found


def _in_own_weather(found: Search) -> Search:
    """The search again in the weather that the best name asks for, where that name isn't enough in the weather of
    before; that search where it is enough there, else the first one."""
    if is_guessed(found.twin) and found.kind == "pair":
        return _two_in_own_weather(found)
    if is_guessed(found.twin) and found.kind == "healthy":
        return _one_in_own_weather(found)
    if found.kind != "law" or not raises_alarm(found, found.singles[0]):
        return found
    more = [item.gain for item in (*found.nameless()[:1], *found.local[:1])]
    if max(more, default=0.0) > _WITHIN * found.gain(found.singles[0]):
        return found
    chosen, here = found, found
    name = found.singles[0].candidate.names
    for _ in range(_WEATHERS):
        other = in_weather_of(here, here.singles[0])
        if other is None:
            break
        here = _in_short(other, found.settings)
        if here.singles[0].candidate.names != name:
            break
        if here.kind == "single":
            _explain(here)
        if here.kind == "single":
            chosen = here
    return chosen


def _two_in_own_weather(found: Search) -> Search:
    """Two effects, or the leading one alone in the weather that it asks for, where that is enough and likelier.

    The weather that health alone asks for is an effect's to a part, and the rest of it a second effect: of a compressor
    whose flow was 7.9 % short at 930 hPa that was 897 hPa, 10 K too little in the charge, 5.2 % and a warm intake.
    """
    here = found

    def ahead(gain: float) -> float:
        spent = pair_bar(found, found.best.fit) if found.best is not None else 0.0
        return ahead_of(
            here, found, lambda each: (gain if each is here else found.explained() - spent) - cost_of_weather(each.twin)
        )

    for there in _where_lead_asks(found):
        here = there
        if ahead(here.gain(here.singles[0])) < -_FAR_BEHIND:
            return found
    if here is found or ahead(here.gain(here.singles[0])) < 0.0:
        return found
    _explain(here)
    return here if here.kind == "single" else found


def _one_in_own_weather(found: Search) -> Search:
    """What seems well in the weather that health alone asks for, or what a name that is near an alarm there is in its
    own: an alarm by as much as anywhere.

    That weather may be the effect's for the most part: of a charge cooler's loss of 7 % were left 3.7 %, no alarm, and
    a charge 9 K too warm, where 140 more is explained by the loss in the weather that it was recorded in.
    """
    if found.gain(found.singles[0]) < _NEAR_ALARM * found.gain_of_alarm:
        return found
    here = [found, *_where_lead_asks(found)][-1]
    if here is found or not raises_alarm(here, here.singles[0]):
        return found

    def ahead(gain: float) -> float:
        return ahead_of(here, found, lambda each: gain * (each is here) - cost_of_weather(each.twin))

    if ahead(here.gain(here.singles[0])) < here.gain_of_alarm:
        return found
    _explain(here)
    named = here.kind not in ("healthy", "law")
    return here if named and ahead(here.explained()) >= here.gain_of_alarm else found


def _where_lead_asks(found: Search) -> Iterator[Search]:
    """Searches up to single effects, each in the weather that the leading one of the search before asks for by itself;
    none where it is there."""
    here = found
    for _ in range(_WEATHERS):
        other = in_weather_of(here, here.singles[0])
        if other is None:
            return
        here = about_leading_name(with_singles(prepare(other, found.settings)))
        yield here


def _in_short(twin: Twin, settings: SearchSettings, earlier: Sequence[Search] = ()) -> Search:
    """The search of a twin under other circumstances, without what acts in parts and without two effects: "single"
    where the best name is enough by itself, "law" where something has no name, else "healthy". Several recordings are
    searched whole.

    Args:
        twin: under those circumstances.
        settings: thresholds.
        earlier: searches up to their single effects, one of which may be under the same circumstances.
    """
    there = next((each.anew() for each in earlier if same_circumstances(each.twin, twin)), None)
    found = about_leading_name(there or with_singles(prepare(twin, settings)))
    if isinstance(found.twin, OverRecordings):  # what begins between two recordings is a name as well
        _explain(found)
        return found
    alarm, unnamed = score_unnamed(found)
    if alarm:
        found.kind = "single"
        if not single_stands(found):
            _nameless(found)
    elif unnamed is not None or shown_by_simulation(found):
        _nameless(found)
    return found


def _explain(found: Search, *, in_full: bool = False) -> None:
    """Everything beyond single effects but a law: what has no name, onsets and regions, two effects.

    `in_full`: terms without a name are scored first in any case. Else that waits, where the best name is an alarm
    whatever they say, until they are chosen from: they are scored anew where the likelihood is renewed.
    """
    found.kind, found.best, found.stage = "healthy", None, STAGES[0]
    found.refused, found.pairs = "", []  # of a search before names were refitted by their derivatives
    found.scanned = scan_all(found.null, found.scored, found.settings.least_share)
    tried = [*found.scanned, *(variant for variant, _ in found.variants)]
    once = [variant for variant in tried if not variant.gone]  # many parts follow the driving where a map is off
    hidden = any(variant.gain > hidden_bar(found, variant) for variant in once)
    waits = not in_full and not found.structure and clearly_named(found)
    alarm, unnamed = (True, None) if waits else score_unnamed(found)
    clock = time.perf_counter()
    if alarm or hidden:
        found.stage = "onsets and regions"
        try_variants(found)
    found.seconds["variants"] = time.perf_counter() - clock
    if not alarm and not (hidden and shown_in_part(found)):
        if unnamed is not None or shown_by_simulation(found):
            _nameless(found)
        return
    found.kind, found.stage = "single", "two effects"
    first = recentred(found, found.singles[0])
    found.best = first
    clock = time.perf_counter()
    try_pairs(found, first)
    widened = pair_beats_single(found)
    if widened:  # which two is another question: the strongest by itself may be neither
        try_more_pairs(found)
    _choose_settled(found, first)
    if found.refused in ("single", "pair") and not widened and try_more_pairs(found):
        found.refused = ""
        _choose_settled(found, first)
    found.seconds["pairs"] = time.perf_counter() - clock
    if found.kind == "law":
        _nameless(found)


def _choose_settled(found: Search, first: Linearisation) -> None:
    """The choice among all, with what was learned of the maps about the explanation that leads."""
    renewed = about_the_leader(found)
    if not found.structure:
        score_terms(found, found.null)
    choose(found, None if renewed else first)


def _nameless(found: Search) -> None:
    """No name fits."""
    found.kind, found.stage, found.best = "law", STAGES[-1], None


def _with_law(found: Search) -> Search:
    """The search with a law from the grammar where no name fits and one is resolved: first in the weather as it was
    assumed, then, where the law asks for another, in that of the fit without any; whichever explains more."""
    other = in_assumed_weather(found)
    if other is None:
        look_for_law(found)
        return found
    here = _in_short(other, found.settings, found.earlier)
    if here.kind == "law":
        look_for_law(here)
        if here.law is not None and weather_is_settled(here):
            return here
    look_for_law(found)
    return _better_law(found, here) if here.kind == "law" else found


def _with_reading_in_time(found: Search) -> Search:
    """The search with the law of a reading that lags and isn't late as well, where that explains more.

    A name that is enough without that clock is none: the clock was found beside the best name.
    """
    other = with_reading_in_time(found)
    if other is None:
        return found
    here = _in_short(other, found.settings, found.earlier)
    if here.kind != "law":
        return found
    look_for_law(here)
    return _better_law(found, here)


def _better_law(one: Search, other: Search) -> Search:
    """The search whose law explains more of the readings that both use."""
    return likelier(one, other, lambda found: 0.0 if found.law is None else found.law.score)
