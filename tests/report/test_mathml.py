"""Laws typeset: every law of the catalogue is well-formed MathML, and formulas of the search keep their meaning."""

from __future__ import annotations

import re
import xml.etree.ElementTree as xml

import pytest

from dieseltwin.engine.effects import EFFECTS
from dieseltwin.report.mathml import law_markup, symbols_in

WORDS = {"egr_backlash", "vgt_backlash"}  # "play of full width w on the command" is no formula


def plain(markup: str) -> str:
    """The letters of a law without its typesetting."""
    return re.sub(r"\s+|&#x2061;", "", "".join(xml.fromstring(f"<p>{markup}</p>").itertext()).replace("\u2061", ""))


@pytest.mark.parametrize("name", EFFECTS)
def test_every_law_of_the_catalogue_is_typeset(name: str) -> None:
    markup = law_markup(EFFECTS[name].law)
    assert ("<math" in markup) == (name not in WORDS)
    xml.fromstring(f"<p>{markup}</p>")


def test_quotients_roots_and_symbols() -> None:
    markup = law_markup("W_leak = A p_im/sqrt(R_a T_im) Psi(p_amb/p_im)")
    root = xml.fromstring(f"<p>{markup}</p>")
    upper, lower = root.findall(".//mfrac")[0]
    assert "".join(upper.itertext()) == "pim" and lower.find(".//msqrt") is not None
    assert plain(markup) == "Wleak=ApimRaTimΨ(pambpim)"
    assert [symbol.name for symbol in symbols_in("W_leak = A p_im/sqrt(R_a T_im)")] == ["p_im", "T_im"]


@pytest.mark.parametrize(
    ("law", "letters"),
    [
        ("relative change of f_egr: -0.08792 +- 0.0027 (t/300 s)", "relativechangeoffegr:−(0.08792±0.0027)(t300s)"),
        ("relative change of eta_vol: -0.04 ± 0.003 (n_e/1e+03 1/min)^-1",
         "relativechangeofηvol:−(0.04±0.003)(ne103min⁻¹)−1"),
        ("reading of p_em_pa + 3633 ± 6.7e+02 Pa", "readingofpem:+(3633±6.7·102)Pa"),
        ("tau dT/dt = T_em - T, of the reading alone", "τdTdt=Tem−Tofthereadingalone"),
        ("added to P_c: 1.2 W sign(p_im - p_em) |(p_im - p_em)/(2e+05 Pa)|^0.5",
         "addedtoPc:1.2Wsign(pim−pem)|pim−pem2·105Pa|0.5"),
        ("u_egr becomes play[u_egr, 10.2 ± 0.18 %]", "uegrbecomesplay[uegr,(10.2±0.18)%]"),
    ],
)  # fmt: skip
def test_found_laws_keep_their_numbers_and_units(law: str, letters: str) -> None:
    assert plain(law_markup(law)) == letters


@pytest.mark.parametrize("law", ["(1 + ", "a ? b", "<script>alert(1)</script>", "1 + |x", "x = {y}"])
def test_what_is_no_formula_is_shown_as_text(law: str) -> None:
    markup = law_markup(law)
    assert "<math" not in markup and "<script" not in markup
    assert xml.fromstring(f"<p>{markup}</p>").text == law
