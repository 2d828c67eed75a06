"""The sentence says where, what, how large, since when, what it did, what was gained, and what can't be told apart."""

from __future__ import annotations

import pytest
import synthetic_discovery as synthetic

from dieseltwin.api.driving import _column_notes, circumstance_notes
from dieseltwin.discovery.verdict.document import Discrepancy, fit_doubts, with_warnings
from dieseltwin.discovery.verdict.found_circumstance import FoundCircumstance
from dieseltwin.engine.effects import EFFECTS, SITES
from dieseltwin.notes import Note
from dieseltwin.report.circumstance_words import circumstance_words, shown_day
from dieseltwin.report.discovery_words import magnitude_words, sentence, site_words
from dieseltwin.report.points import name_words

OFFSET = {
    "name": "p_im_offset", "probability": 0.99, "equivalent_names": [], "law": "reading + b", "magnitude": -1250.0,
    "std": 60.0, "unit": "Pa", "valid_for": None, "split_by": None,
}  # fmt: skip


def test_named_with_equivalents() -> None:
    assert sentence(synthetic.document()) == (
        "The twin leaves out, in the intake mass balance (the likeliest place), a boost leak of 41.0 ± 2.0 mm², from "
        "the start; the fit of the health parameters alone had put h_tot 47 % too high, eta_sc 20 % too low and "
        "A_vgtmax 11 % too low; on the held-out part the negative log-likelihood falls from 2.81 to 2.50 per sample; "
        "boost_leak cannot be told apart from compressor_efficiency_loss, which a w_c_kg_s sensor would settle."
    )


def test_healthy() -> None:
    text = sentence(Discrepancy.model_validate(synthetic.healthy_content()))
    assert text.startswith("Nothing is missing that this recording could show (p = 0.42)")
    assert "a boost leak of 4.1 mm²" in text and "1.9 kPa at 0.3 kg/s" in text  # not the sizes of half of them
    assert text.endswith("would have been found in 19 of 20 such recordings, smaller ones cannot be ruled out.")
    bare = sentence(Discrepancy.model_validate({**synthetic.healthy_content(), "surely_detectable": {}}))
    assert bare.endswith("the tolerances of the maps explain it.")


def test_what_is_beyond_chance_but_below_its_tolerance_is_not_called_nothing() -> None:
    text = sentence(Discrepancy.model_validate({**synthetic.healthy_content(), "p_value": 2e-11}))
    assert text.startswith("Nothing as large as a fault was found: simulation and recording differ")
    assert "(p = 2e-11)" in text


def test_what_was_seen_but_is_too_small_is_named() -> None:
    size = {"magnitude": 1.0e4, "std": 1.9e3, "unit": "Pa/(kg/s)^2", "law": "p_es = p_amb + k W_t^2"}
    small = {"name": "back_pressure", "probability": 0.97, **size}
    content = {**synthetic.healthy_content(), "p_value": 2e-11, "too_small": small}
    document = Discrepancy.model_validate(content)
    text = sentence(document)
    assert "; what explains it best is a back-pressure behind the turbine of 10.0 ± 1.9 kPa/(kg/s)²" in text
    assert ", too small to be of interest;" in text
    assert "back-pressure" not in text.split("too small")[1]  # nor is a larger one said to be invisible
    assert document.to_json()["too_small"]["name"] == "back_pressure"
    assert "too_small" not in Discrepancy.model_validate(synthetic.healthy_content()).to_json()


def test_an_odd_p_value_without_an_alarm_is_put_in_words() -> None:
    text = sentence(Discrepancy.model_validate({**synthetic.healthy_content(), "p_value": 0.0014}))
    assert text.startswith("No fault is shown beyond doubt, though one healthy recording in 714 looks as odd by chance")


def test_none_of_these_with_and_without_a_law() -> None:
    text = sentence(synthetic.document(effects=[synthetic.UNNAMED]))
    assert "leaves out something, in the intake mass balance" in text
    assert "that no effect of the catalogue explains (the law found for it is W = 0.01004 kg/s p_im/p_amb)" in text
    assert "boost" not in text  # no made-up name
    text = sentence(synthetic.document(effects=[{**synthetic.UNNAMED, "law": None}]))
    assert "(no law for it could be resolved)" in text


def test_a_name_of_another_site_that_is_as_good_leaves_the_place_open() -> None:
    """A withheld blow-by was "in the turbine power (more than 99 % sure)", not told from the compressor's power."""
    for names, sure in ((["compressor_efficiency_loss"], False), ([], True), (["intake_heat"], True)):
        text = sentence(synthetic.document(effects=[{**synthetic.LEAK, "equivalent_names": names}]))
        assert ("(the likeliest place)" in text) is not sure and ("(97 % sure)" in text) is sure


def test_a_drift_of_the_injectors_is_said_to_be_hardly_separable_from_eta_sc() -> None:
    drift = {"name": "injector_drift", "probability": 1.0, "equivalent_names": [], "law": "u_delta (1 + k)",
             "magnitude": 0.06, "std": 0.009, "unit": "-", "valid_for": None, "split_by": None}  # fmt: skip
    location = {**synthetic.LOCATION, "site": "fuel_injection"}
    document = synthetic.document(effects=[drift], location=location, circumstances=[])
    assert "; injector_drift is hardly separable from eta_sc, which could give nearly the same: only " in (
        sentence(document))  # fmt: skip
    assert "hardly separable" not in sentence(synthetic.document())
    (note,) = circumstance_notes(document)
    assert note.removeprefix("note: ") == (
        "in this recording injector_drift looks the same as a fuel signal whose scale, or a fuel whose heating value, "
        "is off by as much"
    )


def test_a_law_that_leaves_much_is_not_sure_of_its_site() -> None:
    # a leak that came and went twice was "in the compressor power (more than 99 % sure)", five times the noise left
    for more in (False, True):
        text = sentence(synthetic.document(effects=[synthetic.UNNAMED], more_is_missing=more))
        assert ("intake mass balance (the likeliest place)" in text) is more
        assert ("% sure" in text) is not more


def test_two_effects_say_their_own_places() -> None:
    text = sentence(synthetic.document(effects=[synthetic.LEAK, synthetic.FRICTION]))
    assert ("a boost leak of 41.0 ± 2.0 mm², and, in the power balance of the turbo shaft, bearing friction of the "
            "turbocharger of 3.10 ± 0.20 µN m s") in text  # fmt: skip
    text = sentence(synthetic.document(effects=[synthetic.LEAK, synthetic.UNNAMED]))
    assert "no effect of the catalogue explains" in text and "and beside it a boost leak" in text


def test_onset_region_and_other_places() -> None:
    location = {**synthetic.LOCATION, "onset_s": 312.4, "regions": [synthetic.REGION], "probability": 0.7,
                "alternatives": [{"site": "turbine_flow", "probability": 0.25}]}  # fmt: skip
    alone = {**synthetic.LEAK, "equivalent_names": []}
    text = sentence(synthetic.document(location=location, effects=[alone]))
    assert ", since 312 s, with 80 % of the evidence at n_e 1200 to 1500 rpm, u_delta 120 to 200 mg/cycle;" in text
    assert "(70 % sure)" in text and "it could also sit in the turbine flow (25 %)" in text
    text = sentence(synthetic.document(location={**location, "onset_s": 1234.0}))
    assert "since 1234 s (20.6 min)" in text


def test_sensor_fault_is_not_missing_physics() -> None:
    location = {**synthetic.LOCATION, "site": "sensor:p_im_pa", "probability": 0.999, "alternatives": []}
    text = sentence(synthetic.document(location=location, effects=[OFFSET]))
    assert text.startswith(
        "A sensor is off, physics is not what is missing: an offset of the p_im reading of −1.250 ± 0.060 kPa "
        "(more than 99 % sure), from the start; "
    )
    assert "no other effect of the catalogue explains the recording as well" in text
    text = sentence(synthetic.document(location=location, effects=[OFFSET, synthetic.LEAK]))
    assert text.startswith("A sensor is off and physics is missing: an offset of the p_im reading of ")
    assert "and, in the intake mass balance, a boost leak of 41.0 ± 2.0 mm²" in text


def test_small_shifts_and_no_gain_are_said() -> None:
    health = {"eta_sc": {"value": 1.2, "std": 0.02, "before": 1.21}}
    fit = {**synthetic.content()["fit"], "held_out_nll_before": 2.5, "held_out_nll_after": 2.50004}
    text = sentence(synthetic.document(health=health, fit=fit))
    assert "the health parameters stay where the fit without it had them" in text
    assert "does not fall (2.500000 before, 2.500040 after)" in text or "does not fall (2.50000" in text
    fit = {**fit, "held_out_nll_after": 2.498, "held_out_rows": 900}
    assert "the held-out part hardly decides: its log-likelihood rises by 1.8" in sentence(synthetic.document(fit=fit))
    fit = {**fit, "held_out_rows": 9000}
    assert "falls from 2.5000 to 2.4980 per sample" in sentence(synthetic.document(fit=fit))
    fit = {**fit, "held_out_nll_after": None}
    assert "no gain on unseen driving is claimed" in sentence(synthetic.document(fit=fit))


def test_the_share_explained_and_what_is_left_are_said() -> None:
    fit = {**synthetic.content()["fit"], "chi2_per_sample_after": 1.33}
    left = "1.33 of chi-square per sample"
    unknown = sentence(synthetic.document(fit=fit))
    assert f"but more is missing ({left} where noise leaves 1), so what is named may imitate" in unknown
    known = {**fit, "share_explained": 0.97}
    text = sentence(synthetic.document(fit=known))
    assert "this explains 97 % of the misfit beyond noise and tolerances" in text
    assert text.endswith(f"{left} is left where noise leaves 1, which maps off within their tolerances explain.")
    assert "but more is missing" in sentence(synthetic.document(fit=known, more_is_missing=True))


def test_more_than_tolerances_allow_is_not_excused_by_them() -> None:
    fit = {**synthetic.content()["fit"], "chi2_per_sample_after": 10.9, "share_explained": 0.83}
    text = sentence(synthetic.document(fit=fit))
    assert "10.90 of chi-square per sample is left where noise leaves 1, more than maps and sensors within" in text


def test_what_is_left_is_tolerances_only_where_they_take_it_up() -> None:
    """A valve stuck for two minutes left 1.56 in exact maps, and of that 1.42 beyond all tolerances."""
    fit = {**synthetic.content()["fit"], "chi2_per_sample_after": 1.56, "share_explained": 0.99}
    for beyond, words in ((1.42, "more than maps and sensors within"), (0.98, "which maps off within")):
        document = synthetic.document(fit={**fit, "chi2_per_sample_beyond": beyond})
        assert words in sentence(document)
        assert [note.code for note in fit_doubts(document)] == ["misfit"] * (beyond > 1.2)
        healthy = Discrepancy.model_validate(synthetic.healthy_content() | {"fit": document.fit.model_dump()})
        assert ("though not all of it" in sentence(healthy)) == (beyond > 1.2)


def test_doubts_of_the_engine_file_and_of_the_weathers_columns_are_in_the_sentence() -> None:
    notes = [Note("check V_d", "wrong_engine"), Note("p_amb_pa may read wrongly", "wrong_column"), Note("b", "reading")]
    for document in (synthetic.document(), Discrepancy.model_validate(synthetic.healthy_content())):
        assert sentence(with_warnings(document, notes)).endswith("; check V_d; p_amb_pa may read wrongly.")


def test_a_column_of_the_weather_that_the_recording_contradicts_is_doubted() -> None:
    for read, words in ((True, "judge the recording again without it"), (False, "was left out")):
        found = FoundCircumstance(
            name="p_amb_pa", value=89_500.0, std=300.0, assumed=101_325.0, unit="Pa", off=True, read=read
        )
        document = synthetic.document(circumstances=[found.model_dump()])
        assert not _column_notes(document, ["t_amb_k"])
        note, = _column_notes(document, ["p_amb_pa", "t_amb_k"])
        assert note.code == "wrong_column" and note.affects == ("p_amb_pa",) and words in note


def test_a_search_that_its_time_ended_says_so() -> None:
    cut = {"limit_s": 20.0, "unfinished": ["two effects", "a law"]}
    ends = "; the time for the search was over before it was through with two effects and a law."
    assert sentence(synthetic.document(out_of_time=cut)).endswith(ends)
    healthy = {"mismatch": False, "location": None, "effects": []}
    for p_value, says in ((0.3, "Nothing was found in the time"), (1e-70, "nothing that was tried in the time")):
        text = sentence(synthetic.document(out_of_time=cut, p_value=p_value, **healthy))
        assert text.endswith(ends) and says in text and "believed of a healthy engine" not in text


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_has_words_and_a_size_with_a_unit(name: str) -> None:
    effect = EFFECTS[name]
    assert "{m}" in EFFECTS[name].phrase
    size = magnitude_words(name, 2.0 * effect.tolerance, 0.2 * effect.tolerance, effect.unit)
    assert "±" in size and "e-" not in size
    plain = EFFECTS[name].plain
    assert plain == (not any(u in size for u in ("mm²", "kPa", "%", "µN m s", "W/K", " s"))), size


@pytest.mark.parametrize("site", SITES)
def test_every_site_has_words(site: str) -> None:
    assert "_" not in site_words(site) or site.startswith("sensor:")


def test_no_deviation_of_a_circumstance_reads_as_zero() -> None:
    late = {"name": "time_shift:u_delta_mg", "assumed": 0.0, "unit": "s", "off": True}
    sharp = FoundCircumstance.model_validate({**late, "value": 0.0496, "std": 0.0013})
    assert circumstance_words(sharp) == "u_delta_mg is recorded 0.0496 ± 0.0013 s late"
    broad = FoundCircumstance.model_validate({**late, "value": -0.21, "std": 0.02})
    assert circumstance_words(broad) == "u_delta_mg is recorded 0.21 ± 0.02 s early"
    hill = {"name": "p_amb_pa", "value": 93120.0, "std": 31.0, "assumed": 101325.0, "unit": "Pa", "off": True}
    assert circumstance_words(FoundCircumstance.model_validate(hill)) == (
        "the ambient pressure is 93.120 ± 0.031 kPa, not 101.3"
    )


@pytest.mark.parametrize(
    ("name", "said"),
    [("p_amb_pa", "which is no fault of the engine"), ("t_im_k", "may be the weather, the charge cooler or how well")],
)
def test_a_charge_at_another_temperature_is_not_said_to_be_no_fault(name: str, said: str) -> None:
    # a loss of eta_vol of 4 % was told as a charge 10 K hotter, "which is no fault of the engine"
    off = {"name": name, "value": 310.0, "std": 2.0, "assumed": 300.0, "unit": "K", "off": True}
    document = Discrepancy.model_validate({**synthetic.healthy_content(), "circumstances": [off]})
    notes = [str(note) for note in circumstance_notes(document)]
    assert said in sentence(document) and said in notes[0]
    assert ("no fault" in sentence(document)) == ("no fault" in notes[0]) == (name != "t_im_k")


def test_health_that_is_no_longer_told_is_said_to_be() -> None:
    """A deviation of 360 times the value was "within their uncertainty"."""
    health = {"A_egrmax": {"value": 3.4e-4, "std": 0.12, "before": 2.4e-4}}
    text = sentence(synthetic.document(health=health))
    assert "A_egrmax can no longer be told beside it" in text and "within their uncertainty" not in text


def test_a_recording_without_a_date_keeps_its_whole_name() -> None:
    assert [shown_day(name) for name in ("recording 12", "2026-03-14T08:00:00")] == ["recording 12", "2026-03-14"]


def test_an_error_of_a_reading_at_settled_points_has_words() -> None:
    assert name_words("w_egr_kg_s:offset") == "an offset of the W_egr reading"
    assert name_words("t_em_k:gain") == "a gain error of the T_em reading"
    assert name_words("back_pressure") == "back_pressure"
