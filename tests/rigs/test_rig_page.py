"""A rig's page: its equations as people write them, and the page in a real browser and on paper."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.rigs import RigDiscovered
from dieseltwin.cli.app import main
from dieseltwin.discovery.verdict.findings import none_of_these
from dieseltwin.errors import InputError
from dieseltwin.report import pdf
from dieseltwin.report.mathml import law_markup
from dieseltwin.rigs.equations import equations, readable
from dieseltwin.rigs.parameters import RigParameters, load_rig, save_rig
from dieseltwin.rigs.verdict import MORE, sentence
from tests.pages import check_page, groups_of
from tests.rigs.test_rig_files import RIGS, TANK

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]


@pytest.mark.parametrize(
    ("formula", "absent", "text"),
    [
        ("k*root(h + h0)", (), "k*sqrt(h + h0)"),
        ("k*root(h + h0)", ("h0",), "k*sqrt(h)"),
        ("a - (b - c)", (), "a - (b - c)"),
        ("a - b + c*0 - d/e/f", ("a",), "-b - d/e/f"),
        ("force - drag*v*abs(v) - constant", ("constant", "drag"), "force"),
        ("a/(b*c)", (), "a/(b*c)"),
        ("(a + b)**2*where_positive(v)", ("b",), "a^2*[v > 0]"),
        ("k*(positive(u - u0) + c*u*abs(u))", ("c",), "k*max(0, u - u0)"),
    ],
)
def test_a_formula_without_what_is_absent(formula: str, absent: tuple[str, ...], text: str) -> None:
    assert readable(formula, absent) == text
    assert "<math" in law_markup(f"q = {text}")


def test_the_sentence_has_units_and_says_what_is_missing_apart_from_the_names(leaking: Path) -> None:
    found = dt.discover(leaking.parent / "tank.csv", leaking.parent / "tank.yaml")
    assert isinstance(found, RigDiscovered)
    assert re.search(r"Free runs no fit has seen, rms: level \S+ -> \S+ m, ", found.sentence)
    left = none_of_these(MORE)
    both = found.document.model_copy(update={"effects": (*found.document.effects, left)})
    assert f"; beside this {MORE}." in sentence(found.found, both)
    alone = found.document.model_copy(update={"effects": (left,)})
    assert f": {MORE}." in sentence(found.found, alone)
    fit = found.document.fit.model_copy(update={"share_explained": 0.0})
    useless = found.document.model_copy(update={"fit": fit})
    assert " % of the squared error explained." in found.sentence
    assert sentence(found.found, useless).endswith("foretells these no better.")


def test_every_effect_of_the_examples_has_an_equation() -> None:
    for name in ("cascaded_tanks", "positioning_axis"):
        rig = load_rig(RIGS / f"{name}.yaml")
        for effect in rig.effects:
            laws = equations(rig, effect)
            assert laws and all(effect in law and "<math" in law_markup(law) for law in laws), effect


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command makes of a tank that leaks, printed where a browser prints."""
    folder = tmp_path_factory.mktemp("tank")
    time = 0.1 * np.arange(400)
    level = np.exp(-0.5 * time) * 2.0
    flow = 1.0 + np.sin(0.7 * time)
    for k in range(1, time.size):  # the leak begins to matter where the level is high
        middle = 0.5 * (flow[k - 1] + flow[k])
        level[k] = level[k - 1] + 0.1 * (middle - 0.5 * level[k - 1] - 0.2 * level[k - 1] * abs(level[k - 1]))
    noise = 0.002 * np.random.default_rng(1).standard_normal(time.size)
    pd.DataFrame({"time_s": time, "q": flow, "level": level + noise}).to_csv(folder / "tank.csv", index=False)
    leak = {"site": "tank", "law": "c h |h| lost", "unit": "1/(m s)", "tolerance": 0.01, "limits": [0.0, 1.0]}
    balance = {**TANK["quantities"]["balance"], "formula": "q - k*h - leak*h*abs(h)"}
    changed = {"effects": {"leak": leak}, "quantities": {"balance": balance}, "sub_steps": 1}
    rig = RigParameters.model_validate({**TANK, **changed})
    save_rig(rig, folder / "tank.yaml")
    printed = ["--pdf"] if any(map(pdf.shutil.which, pdf.BROWSERS)) else []
    out = folder / "found"
    assert main(["discover", str(folder / "tank.csv"), "--engine", str(folder / "tank.yaml"), "--out", str(out),
                 *printed]) == 0  # fmt: skip
    return out


def test_the_command_ends_in_a_page(leaking: Path) -> None:
    check_page(leaking / "report.html", "balance=q−k·h−leak·h·|h|")
    assert len(groups_of(leaking / "report.html")) == 2
    assert {path.name for path in (leaking / "figures").iterdir()} == {"readings.png", "held_out.png"}
    if any(map(pdf.shutil.which, pdf.BROWSERS)):
        assert (leaking / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.skipif(not CHROMIUM.is_file(), reason=f"no browser at {CHROMIUM}")
def test_the_page_in_a_browser(leaking: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright")
    problems: list[str] = []
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        page = browser.new_page(viewport={"width": 390, "height": 800}, color_scheme="dark")
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto((leaking / "report.html").as_uri())
        page.locator(".panel canvas").first.wait_for()
        assert page.locator(".panel canvas").count() == page.locator(".panel").count() == 5
        assert page.evaluate("document.documentElement.scrollWidth") <= 390  # nothing sticks out on a phone
        page.locator("[data-move=in]").first.click()  # all panels of a group zoom together
        page.locator(".panel").first.hover()
        values = page.locator(".panel").nth(1).locator(".u-value").all_inner_texts()
        assert "–" not in values[0]  # the cursor of one panel is that of the others
        browser.close()
    assert not problems


def test_nothing_left_to_look_for_is_said(leaking: Path) -> None:
    recording, withheld = leaking.parent / "tank.csv", {"withhold": ["leak"]}
    for rig, options in ((leaking.parent / "tank.yaml", withheld), (leaking / "engine.yaml", {})):
        with pytest.raises(InputError, match="tank: effects: got none to look for"):
            dt.discover(recording, rig, **options)  # type: ignore[arg-type]
