"""Files of a learned engine: same bytes whatever the order, nothing taken that isn't what was written."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.engine import load_engine, simulate, we2011
from dieseltwin.engine.inputs import Inputs
from dieseltwin.engine.terms import Term, corrections_in, with_corrections
from dieseltwin.errors import InputError
from dieseltwin.learning import files
from dieseltwin.learning.belief import MAPS_AT, Belief, prior_belief
from dieseltwin.learning.domain import domain_of
from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.files import LearnedEngine, going_on, load_learned, save_learned
from dieseltwin.learning.weather import (
    EXPONENTS,
    WEATHER,
    Exponent,
    OfType,
    as_sure_as_the_weather,
    exponent_words,
    of_own_weather,
)
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording, recording
from dieseltwin.recordings.shared_rows import distinct, overlap
from dieseltwin.settings.defaults import default_search

LEAK = Term(effect="boost_leak", magnitude=2.5e-5)


def _recording(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 30.0, 0.2)
    inputs = Inputs(time, *(np.full(time.size, value) for value in (1300.0, 100.0, 20.0, 50.0)))
    table = simulate(inputs, we2011.PARAMETERS, oxygen=False)
    names = ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s",
             "w_egr_kg_s", "t_em_k", "w_c_kg_s")  # fmt: skip
    frame = table[list(names)].copy()
    for name in names[5:]:
        frame[name] *= 1.0 + 0.01 * rng.standard_normal(time.size)
    return recording(frame)


def _belief() -> Belief:
    rng = np.random.default_rng(7)
    prior = prior_belief(we2011.PARAMETERS, 0.02)
    half = np.diag(np.sqrt(np.diag(prior.covariance)))
    whole = half @ (np.eye(len(half)) - 0.9 * np.diag(rng.random(len(half)))) @ half
    mean = prior.mean.copy()
    mean[MAPS_AT] = 0.01 * rng.standard_normal(MAPS_AT.stop - MAPS_AT.start)
    return Belief(mean, whole)


def _learned(*recordings: Recording) -> LearnedEngine:
    kept, belief = distinct(recordings), _belief()
    domain = domain_of(belief, 0.02, we2011.PARAMETERS)
    return LearnedEngine(we2011.PARAMETERS, belief, 0.02, kept, domain, {item.sha256: 1.0 for item in kept})


@pytest.fixture
def two() -> tuple[Recording, Recording]:
    return _recording(1), _recording(2)


def test_round_trip_keeps_everything(tmp_path: Path, two):
    leak = FaultBeside("exhaust_leak", "m2", 3.3e-5, 3e-6, 121.0, 5e-6, 104.0)
    exponents = {"k_cflow": Exponent(1.02, 0.03)}
    learned = replace(_learned(*two), faults=(leak,), exponents=exponents)
    save_learned(learned, tmp_path / "mine.yaml")
    again = load_learned(tmp_path / "mine.yaml")
    assert again is not None and again.faults == (leak,) and again.exponents == exponents
    assert again.engine == learned.engine and again.engine.k_cflow == 1.02 and again.engine.k_cspeed == 0.5
    before = default_search().circumstances
    assert (again.beliefs(before).k_cflow, again.beliefs(before).k_cspeed) == (0.03, before.k_cspeed)
    assert np.array_equal(again.belief.mean, learned.belief.mean)
    assert np.array_equal(again.belief.covariance, learned.belief.covariance)
    assert again.base == learned.base and again.domain == learned.domain
    assert [item.sha256 for item in again.recordings] == [item.sha256 for item in learned.recordings]
    assert np.array_equal(again.recordings[0].columns["p_em_pa"], learned.recordings[0].columns["p_em_pa"])


def test_order_and_repetition_change_no_byte(tmp_path: Path, two):
    first, second = two
    for name, some in (("a", (first, second)), ("b", (second, first, second))):
        (tmp_path / name).mkdir()
        save_learned(_learned(*some), tmp_path / name / "mine.yaml")
    for name in ("mine.yaml", "mine.learned.parquet"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_copy_with_the_same_rows_counts_once(two):
    first, second = two
    columns = {**first.columns, "oil_k": np.full(first.time_s.size, 360.0)}
    copy = replace(first, columns=columns, sha256="0" * 64)
    assert distinct([first, second, copy]) == distinct([copy, second, first])
    assert [item.sha256 for item in distinct([first, copy])] == [copy.sha256]


@pytest.mark.parametrize("killed_at", ["mine.learned.parquet.before", "mine.learned.parquet", "mine.yaml"])
def test_learning_more_that_is_killed_leaves_one_of_both(
    tmp_path: Path, two, killed_at: str, monkeypatch: pytest.MonkeyPatch
):
    path, less, more = tmp_path / "mine.yaml", _learned(two[0]), _learned(*two)
    save_learned(less, path)

    def killed(write: Callable[..., None]) -> Callable[..., None]:
        def until(target: Path, content: bytes | str) -> None:
            write(target, content)
            if target.name == killed_at:
                raise KeyboardInterrupt

        return until

    for _ in range(2):  # what is killed once may be killed again
        with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
            for name in ("write_bytes", "write_text"):
                patched.setattr(files, name, killed(getattr(files, name)))
            save_learned(more, path)
        known = load_learned(path)
        assert known is not None
        assert len(known.recordings) == (2 if killed_at == "mine.yaml" else 1)
        assert corrections_in(load_engine(path).terms) is not None
    save_learned(more, path)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["mine.learned.parquet", "mine.yaml"]


def test_files_that_differ_in_their_ending_have_each_its_own_beside_them(tmp_path: Path, two):
    names = [save_learned(_learned(*two), tmp_path / name).name for name in ("mine.yaml", "mine.yml")]
    assert names == ["mine.learned.parquet", "mine.yml.learned.parquet"]


def test_every_command_gets_the_mean_corrections(tmp_path: Path, two):
    learned = _learned(*two)
    save_learned(learned, tmp_path / "mine.yaml")
    engine = load_engine(tmp_path / "mine.yaml")
    found = corrections_in(engine.terms)
    assert found is not None and np.array_equal(found, learned.belief.coefficients)


@pytest.mark.parametrize("change", ["missing", "changed", "cut"])
def test_a_second_file_that_is_missing_or_changed_is_refused(tmp_path: Path, two, change: str):
    target = save_learned(_learned(*two), tmp_path / "mine.yaml")
    content = target.read_bytes()
    if change == "missing":
        target.unlink()
    else:
        target.write_bytes(content[:-100] if change == "cut" else content[:500] + b"x" + content[501:])
    for read in (load_learned, load_engine):
        with pytest.raises(InputError, match="learn"):
            read(tmp_path / "mine.yaml")


def test_rows_of_the_reference_are_recognised(two):
    first, second = two
    part = Recording(first.time_s[50:], {k: v[50:] for k, v in first.columns.items()}, 1e5, 298.0)
    assert overlap((first, second), part) == 1.0
    assert overlap((second,), first) < 0.01


@pytest.mark.parametrize("turned", [False, True])
def test_rows_are_recognised_where_one_has_a_sensor_more(two, turned: bool):
    one, other = two[0], replace(two[0], columns={k: v for k, v in two[0].columns.items() if k != "w_c_kg_s"})
    known, asked = (other, one) if turned else (one, other)
    assert overlap((known,), asked) == 1.0 and overlap((two[1],), asked) == 0.0
    inputs_alone = replace(one, columns={k: v for k, v in one.columns.items() if k in INPUTS})
    assert overlap((one,), inputs_alone) == 0.0  # of the same cycle on two days


def test_what_an_engine_is_built_like_is_not_changed_behind_what_was_learned(tmp_path: Path, two):
    """`simulate` took the new displacement and `discover` the old one, without a word."""
    path = tmp_path / "mine.yaml"
    save_learned(_learned(*two), path)
    lines = [line for line in path.read_text().splitlines() if not line.startswith("# content_sha256:")]
    path.write_text("\n".join(lines).replace(f"V_d: {we2011.PARAMETERS.V_d}", "V_d: 0.015"))
    with pytest.raises(InputError, match=r"V_d: got 0\.015; allowed: 0\.012"):
        load_learned(path)


def _repaired(learned: LearnedEngine) -> LearnedEngine:
    """As a discovery beside it leaves the engine: another health, maps moved a little, and a leak."""
    maps = with_corrections((), learned.belief.coefficients + 1e-3)
    return replace(learned, repaired=learned.engine.replace(A_egrmax=3.5e-4, T_amb=280.0, terms=(*maps, LEAK)))


def test_a_repaired_engine_is_still_the_learned_one(tmp_path: Path, two):
    learned = _learned(*two)
    plain = save_learned(learned, tmp_path / "mine.yaml")
    beside = save_learned(_repaired(learned), tmp_path / "engine.yaml")
    assert beside.name == "engine.learned.parquet" and beside.read_bytes() == plain.read_bytes()
    again, engine = load_learned(tmp_path / "engine.yaml"), load_engine(tmp_path / "engine.yaml")
    assert again is not None and again.engine == engine and engine.A_egrmax == 3.5e-4
    assert again.found == (LEAK,) and again.moved == pytest.approx(1e-3, abs=1e-12)
    assert np.array_equal(again.belief.health, learned.belief.health)  # health is still said since the reference
    assert corrections_in(engine.terms) == pytest.approx(learned.belief.coefficients + 1e-3)
    save_learned(again, tmp_path / "twice.yaml")
    twice = load_learned(tmp_path / "twice.yaml")
    assert twice is not None and twice.found == (LEAK,) and twice.moved == pytest.approx(again.moved, abs=1e-12)
    beside.unlink()
    for read in (load_learned, load_engine):
        with pytest.raises(InputError, match="both files"):
            read(tmp_path / "engine.yaml")


def test_an_engine_that_is_as_it_was_learned_is_not_repaired(tmp_path: Path, two):
    save_learned(_learned(*two), tmp_path / "mine.yaml")
    known = load_learned(tmp_path / "mine.yaml")
    assert known is not None and known.repaired is None and known.moved is None and not known.found
    save_learned(replace(known, repaired=known.engine), tmp_path / "healthy.yaml")
    assert load_engine(tmp_path / "healthy.yaml") == known.engine


def _other_weather(path: Path, change: Callable[[str], str]) -> None:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("# content_sha256:")]
    path.write_text("\n".join(line for line in map(change, lines) if line))


def test_a_file_of_before_has_its_compressor_in_the_weather_of_its_recordings(tmp_path: Path, two):
    path = tmp_path / "mine.yaml"
    one, other = (replace(item, p_amb_pa=p_amb, t_amb_k=290.0) for item, p_amb in zip(two, (9e4, 1e5), strict=True))
    learned = _learned(one, other)
    save_learned(learned, path)
    assert learned.engine.p_cmap == pytest.approx(9.5e4) and learned.engine.k_cflow == 0.5
    _other_weather(path, lambda line: "" if line.split(":")[0] in (*EXPONENTS, *WEATHER) else line)
    assert load_engine(path).k_cflow == 0.0  # as it was written
    known = load_learned(path)
    assert known is not None and known.repaired is None and known.engine == learned.engine


def test_exponents_are_no_surer_than_the_weather_that_shows_them(two):
    beliefs, shown = default_search().circumstances, {name: Exponent(1.0, 0.01) for name in EXPONENTS}
    days = [replace(item, t_amb_k=at, p_amb_pa=p_amb, columns={**item.columns, "p_amb_pa": one, "t_amb_k": one})
            for item, at, p_amb in zip(two, (280.0, 300.0), (1e5, 8.5e4), strict=True)
            for one in [np.ones(item.time_s.size)]]  # fmt: skip
    said = as_sure_as_the_weather(shown, days, of_own_weather(we2011.PARAMETERS, days), beliefs)
    assert 0.03 < said["k_cflow"].std < 0.06 and 0.15 < said["k_cspeed"].std < 0.3
    unread = [replace(item, columns=one.columns) for item, one in zip(days, two, strict=True)]
    empty = [replace(item, columns={**item.columns, "p_amb_pa": np.full(item.time_s.size, np.nan)}) for item in days]
    same = [replace(item, t_amb_k=290.0, p_amb_pa=9e4) for item in unread]  # no column gives any: no division by it
    for some in (unread, empty):
        assert as_sure_as_the_weather(shown, some, of_own_weather(we2011.PARAMETERS, days), beliefs) == {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert as_sure_as_the_weather(shown, same, of_own_weather(we2011.PARAMETERS, same), beliefs) == {}


def test_the_weather_of_recordings_is_the_same_in_any_order(two):
    days = [replace(item, sha256=name, p_amb_pa=p_amb, t_amb_k=t_amb) for item, name, p_amb, t_amb in
            zip((*two, *two), "abcd", (101325.3, 94012.7, 88000.1, 99000.77), (293.15, 281.37, 301.9, 277.77),
                strict=True)]  # fmt: skip
    assert len({of_own_weather(we2011.PARAMETERS, some) for some in permutations(days)}) == 1


def test_what_engines_of_the_type_say_is_kept_and_its_weather_is_that_of_the_maps(tmp_path: Path, two):
    told = OfType({"k_cflow": Exponent(0.97, 0.03)}, 9.3e4, 281.0)
    learned = replace(_learned(*two), of_type=told, exponents=told.exponents)
    save_learned(learned, tmp_path / "mine.yaml")
    known = load_learned(tmp_path / "mine.yaml")
    assert known is not None and known.of_type == told and known.repaired is None
    engine = known.engine
    assert (engine.p_cmap, engine.T_cmap, engine.k_cflow, engine.k_cspeed) == (9.3e4, 281.0, 0.97, 0.5)
    assert "as engines of its type show" in exponent_words(known.exponents, known.of_type)[0]
    assert "recordings in different weather show" in exponent_words(known.exponents)[0]


def test_an_engine_file_may_say_how_its_compressor_goes_and_not_in_which_weather_it_was_learned(tmp_path: Path, two):
    path, corrected = tmp_path / "mine.yaml", we2011.PARAMETERS.replace(k_cflow=1.0)
    assert of_own_weather(corrected, two).k_cflow == 1.0 and of_own_weather(corrected, two).k_cspeed == 0.5
    save_learned(_learned(*two), path)
    _other_weather(path, lambda line: "k_cflow: 1.0" if line.startswith("k_cflow") else line)
    known = load_learned(path)
    assert known is not None and known.engine.k_cflow == 1.0 and not known.found
    _other_weather(path, lambda line: "T_cmap: 260.0" if line.startswith("T_cmap") else line)
    with pytest.raises(InputError, match=r"T_cmap: got 260"):
        load_learned(path)


def test_learning_goes_on_from_an_engine_as_it_was_learned(two):
    known = _learned(*two)
    assert going_on("mine.yaml", known.base, known) == []
    with pytest.raises(InputError, match=r"found/engine\.yaml, repaired by boost_leak; allowed: the engine as it was"):
        going_on("found/engine.yaml", known.base, _repaired(known))
    worn = replace(known, repaired=known.engine.replace(A_egrmax=3.5e-4))
    assert "isn't learned from" in going_on("found/engine.yaml", known.base, worn)[0]
    assert "corrected without a word" in going_on("old.yaml", known.engine, None)[0]


@pytest.mark.parametrize(("before", "after"), [("c_m: [1.35634407,", "c_m: [1.4,"), ("eta_cmax: 0.7364\n", "")])
def test_maps_and_missing_lines_count_as_changes_too(tmp_path: Path, two, before: str, after: str):
    path, learned = tmp_path / "mine.yaml", _learned(*two)
    save_learned(replace(learned, base=learned.base.replace(eta_cmax=0.7364)), path)
    lines = [line for line in path.read_text().splitlines() if not line.startswith("# content_sha256:")]
    text = "\n".join(lines)
    assert before in text
    path.write_text(text.replace(before, after))
    with pytest.raises(InputError, match="with which it was learned"):
        load_learned(path)


def test_a_file_without_learned_corrections_is_an_ordinary_one(tmp_path: Path):
    path = tmp_path / "base.yaml"
    path.write_text("eta_sc: 1.05\n")
    assert load_learned(path) is None
