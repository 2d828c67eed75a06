"""In a real browser, from drop to verdict: Chromium through Playwright, with what a user does and what can go wrong."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.api.simulated import drive
from tests.app.conftest import logged

playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright")
CHROMIUM = Path("/usr/bin/chromium")
pytestmark = [pytest.mark.skipif(not CHROMIUM.is_file(), reason=f"no browser at {CHROMIUM}"), pytest.mark.timeout(900)]
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync"]  # fmt: skip
SLOW_MS = 400_000  # a busy machine, and a fresh clone compiles its kernels here


def free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


class Server:
    """The real command on a port of its own, which can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "dieseltwin", "app", "--port", str(self.port), "--folder", str(self.folder),
                   "--largest", "2"]  # fmt: skip
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})
        end = time.monotonic() + 60.0
        while True:
            try:
                assert httpx.get(self.url).status_code == 200
                return
            except httpx.TransportError:
                assert time.monotonic() < end and self.process.poll() is None
                time.sleep(0.1)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    found = Server(tmp_path_factory.mktemp("browser") / "kept")
    yield found
    found.process.terminate()
    assert found.process.wait(20.0) is not None


@pytest.fixture(scope="module")
def browser() -> Iterator[playwright.Browser]:
    with playwright.sync_playwright() as running:
        found = running.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        yield found
        found.close()


def test_from_drop_to_verdict(server: Server, browser: playwright.Browser, logger_csv: bytes, tmp_path: Path) -> None:
    problems: list[str] = []
    foreign: list[str] = []
    page = browser.new_page()
    page.set_default_timeout(SLOW_MS)
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda request: foreign.append(request.url) if not request.url.startswith(server.url) else None)
    page.goto(server.url)

    # by keyboard: the first stop leads past the navigation
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"

    # too large is said before anything is sent
    (tmp_path / "large.csv").write_bytes(bytes(3_000_000))
    page.set_input_files("#file", tmp_path / "large.csv")
    page.click("#drop button")
    assert "at most 2 MB" in page.inner_text("#drop-problem")
    assert page.evaluate("document.activeElement.id") == "drop-problem"

    # a file is dropped onto the field
    data = page.evaluate_handle(
        "text => { const data = new DataTransfer(); "
        "data.items.add(new File([text], 'Fahrt <img src=x onerror=alert(1)>.csv')); return data; }",
        logger_csv.decode(),
    )
    page.dispatch_event("#drop", "drop", {"dataTransfer": data})
    page.wait_for_selector("#map-title")
    assert "<img src=x" in page.inner_text("h1")
    assert page.eval_on_selector("[name=channel-p_im_pa]", "s => s.selectedOptions[0].text").startswith("Ladedruck")

    # a wrong unit is refused in words
    page.select_option("[name=reading-p_im_pa]", "unit:bar")
    page.click("text=Save the map and try it")
    page.wait_for_selector("#check .alert")
    page.select_option("[name=reading-p_im_pa]", "unit:kPa")
    page.click("text=Save the map and try it")
    page.wait_for_selector("#check .tag.done")

    # the verdict comes by itself, also to somebody who closed the page
    page.check("[value=identify]")
    page.click("text=Start")
    page.wait_for_url("**/jobs/*")
    job = page.url
    page.close()
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.set_default_timeout(SLOW_MS)
    page.goto(job)
    page.wait_for_selector(".verdict")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390  # nothing sticks out on a phone
    with page.expect_download() as download:
        page.click("text=All data (zip)")
    assert download.value.path().stat().st_size > 10_000
    # the report lies in a sandbox, and its panels are drawn there
    page.frame_locator("iframe.report").locator(".panel canvas").first.wait_for()
    page.close()
    assert not foreign  # it works offline
    assert problems == []


@pytest.mark.thorough
def test_an_engine_is_learned_and_judges_by_keyboard_and_on_a_phone(
    server: Server, browser: playwright.Browser, tmp_path: Path
) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.set_default_timeout(SLOW_MS)
    (tmp_path / "well.csv").write_bytes(logged(drive(65.0, seed=6)))
    page.goto(server.url)
    page.set_input_files("#file", tmp_path / "well.csv")
    page.click("#drop button")
    page.wait_for_selector("#map-title")

    page.get_by_role("link", name="Engines").first.focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("#learn-title")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.get_by_role("checkbox", name="well.csv").focus()
    page.keyboard.press("Space")
    page.focus("#name")
    page.keyboard.type("truck 7")
    page.keyboard.press("Enter")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector(".verdict")
    assert page.inner_text(".verdict").startswith("Learned from 1.1 minutes of 1 recording;")
    page.click("text=Open the kept engine")
    page.wait_for_selector("text=What was learned")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert "corrections of maps" in page.inner_text("#file-title ~ .scroll")

    # it can be chosen, and judges
    page.click("#history-title ~ p a")
    page.click("text=well.csv")
    page.check("[value=identify]")
    page.select_option("#engine", label="truck 7 (learned)")
    page.click("text=Start")
    page.wait_for_selector(".verdict")
    assert "missing" not in str(page.get_attribute(".verdict", "class"))  # a decimal comma is no doubt
    assert "decimal comma" in page.inner_text("#health-title ~ p")
    page.click("nav >> text=Engines")
    page.click("text=truck 7")
    page.wait_for_selector("#history-title ~ table")
    assert "well.csv" in page.inner_text("#history-title ~ table")
    page.close()


@pytest.mark.thorough
def test_a_killed_server_says_what_it_interrupted(server: Server, browser: playwright.Browser) -> None:
    page = browser.new_page()
    page.set_default_timeout(SLOW_MS)
    page.goto(server.url)
    page.click("section[aria-labelledby=recordings-title] td a")
    page.check("[value=discover]")
    page.click("text=Start")
    page.wait_for_selector(".stages .now")
    server.kill()
    page.goto("about:blank")  # the analysis's page loads itself again once the server answers
    server.start()
    page.goto(server.url)
    page.wait_for_selector(".tag.interrupted")
    page.click("section[aria-labelledby=analyses-title] tbody tr:first-child a")
    assert "Nothing is half-written" in page.inner_text(".warning")
    page.click("text=Start again")
    page.wait_for_selector(".stages .now")
    page.click("text=Stop")
    page.wait_for_selector("#state.stopped")
    page.close()
