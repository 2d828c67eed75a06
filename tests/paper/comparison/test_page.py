"""The page: self-contained, complete, safe, and built from whatever was stored."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
import stored_results as synthetic

from dieseltwin.errors import InputError
from dieseltwin.paper.comparison.page import SIZE_LIMIT_BYTES, build_report
from dieseltwin.report import quantities
from dieseltwin.report.results import load_results
from tests.pages import without_pictures


class Loads(HTMLParser):
    """Collects everything that a browser would fetch, and the visible text."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.text: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for key, value in attrs:
            if key in ("src", "srcset", "data", "poster") or (key == "href" and tag in ("link", "use")):
                self.loads.append(value or "")
            if key == "href" and tag == "a":
                assert (value or "").startswith("#"), f"a link leads out: {value}"

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def parse(path: Path) -> Loads:
    parser = Loads()
    parser.feed(path.read_text(encoding="utf-8"))
    return parser


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that a folder may hold, of one method and one segment: drawing a full page takes ten seconds."""
    root = synthetic.write_results(tmp_path_factory.mktemp("one") / "results", ("classical",), segments=1)
    driving = root / "driving"
    driving.mkdir()
    (driving / "set_ii.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"/>')
    return root


@pytest.fixture(scope="module")
def page(one: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_report(one, tmp_path_factory.mktemp("page") / "new" / "report.html")


def test_page_loads_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    parser = parse(page)
    assert parser.loads and all(load.startswith("data:image/") for load in parser.loads)
    assert parser.tags.count("script") == 2 and "link" not in parser.tags and "iframe" not in parser.tags
    assert not re.search(r"fetch\(|XMLHttpRequest|import\(", text)
    outside = re.sub(r'<script[^>]*>.*?</script>|src="data:[^"]*"', "", text, flags=re.DOTALL)
    assert not re.search(r"https?://|//[a-z]|@import|url\(", outside)
    assert len(text.encode()) < SIZE_LIMIT_BYTES


def test_page_has_every_section_and_the_numbers(one: Path, page: Path) -> None:
    parser = parse(page)
    text = " ".join(" ".join(parser.text).split())
    for title in ("Summary", "Driving", "Health parameters", "Accuracy", "States and flows", "Residuals", "Run times",
                  "Training", "Provenance", "Machine and times"):  # fmt: skip
        assert title in text
    estimate = load_results(one).methods[0].pooled["A_vgtmax"]
    assert quantities.value_with_std("A_vgtmax", estimate.mean, estimate.std, with_unit=False) in text
    assert "Beside the paper's table" in text and "7.19 %" in text  # its A_egrmax in the first minute
    assert "0" * 64 in text and "seed" in text  # provenance
    assert any(load.startswith("data:image/svg+xml") for load in parser.loads)  # the picture of the driving


def test_same_results_same_page(tmp_path: Path) -> None:
    root = synthetic.write_results(
        tmp_path / "r", ("classical",), segments=1, states=False, pretraining=False
    )
    first = build_report(root, tmp_path / "one.html")
    assert build_report(root, tmp_path / "two.html").read_bytes() == first.read_bytes()


def test_recording_without_truth_one_segment_one_method(tmp_path: Path) -> None:
    root = synthetic.write_results(
        tmp_path / "r", ("classical",), segments=1, truth=False, states=False, pretraining=False
    )
    with without_pictures():
        text = build_report(root, tmp_path / "x.html").read_text(encoding="utf-8")
    assert "truth not known" in text and "std over bound" in text
    assert ">truth</th>" not in text and "the truth is known" not in text
    assert "1 segment)" in text


def test_linked_folders_and_figures_as_files(tmp_path: Path) -> None:
    root = synthetic.write_results(
        tmp_path / "r", ("classical",), segments=1, states=False, pretraining=False
    )
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "classical").symlink_to(root / "classical", target_is_directory=True)
    page = build_report(tmp_path / "linked", tmp_path / "x.html", figures_dir=tmp_path / "figures")
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert "violins.svg" in names and page.read_text(encoding="utf-8").count("<figure") == len(names)


def test_nothing_identifiable_and_no_states(tmp_path: Path) -> None:
    root = synthetic.write_results(
        tmp_path / "r",
        ("classical", "few-shot-adam"),
        segments=2,
        states=False,
        pretraining=False,
        nothing=True,
    )
    with without_pictures():
        text = build_report(root, tmp_path / "x.html").read_text(encoding="utf-8")
    assert "could not identify any health parameter" in text and text.count("not identifiable here") >= 8
    assert not re.search(r"\bnan\b", re.sub(r'src="data:[^"]*"', "", text))


def test_diverged_runs_and_null_values(tmp_path: Path) -> None:
    root = synthetic.write_results(tmp_path / "r", ("few-shot-newton",), segments=1, states=False, truth=False,
                                   pretraining=False, diverged=True)  # fmt: skip
    path = root / "few-shot-newton" / "identification.json"
    document = json.loads(path.read_text())
    broken = {
        "mean": None,
        "std": None,
        "interval_90": None,
        "unit": "m2",
        "bound": None,
        "identifiable": False,
    }
    document["segments"][0]["parameters"]["A_egrmax"] = broken
    document["parameters"]["A_egrmax"] = broken
    for run in document["runs"][:4]:
        run["segments"][0]["parameters"]["h_tot"] = {"value": None, "std": None}
    path.write_text(json.dumps(document))
    (root / "few-shot-newton" / "runtime.json").unlink()
    with without_pictures():
        text = build_report(root, tmp_path / "x.html").read_text(encoding="utf-8")
    assert "did not converge" in text and "not identifiable here" in text


def test_names_from_files_cannot_inject(tmp_path: Path) -> None:
    root = synthetic.write_results(
        tmp_path / "r", ("classical",), segments=1, states=False, truth=False, pretraining=False
    )
    (root / "report.json").write_text(json.dumps({"title": "<script>alert(1)</script>", "recording": "<b>&"}))
    with without_pictures():
        text = build_report(root, tmp_path / "x.html").read_text(encoding="utf-8")
    assert "<script" not in text and "&lt;script&gt;" in text and "&lt;b&gt;&amp;" in text


@pytest.mark.parametrize("content", ["", "{", '{"schema": 1}', "[1]"])
def test_broken_documents_are_one_line_errors(tmp_path: Path, content: str) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "identification.json").write_text(content)
    with pytest.raises(InputError) as caught:
        build_report(tmp_path, tmp_path / "x.html")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "x.html").exists()


def test_empty_folder_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="make run"):
        build_report(tmp_path, tmp_path / "x.html")


def test_truncated_table_is_an_error(tmp_path: Path) -> None:
    root = synthetic.write_results(tmp_path / "r", ("classical",), segments=1, pretraining=False)
    states = root / "classical" / "states.parquet"
    states.write_bytes(states.read_bytes()[:400])
    with pytest.raises(InputError, match=r"states\.parquet"):
        build_report(root, tmp_path / "x.html")
