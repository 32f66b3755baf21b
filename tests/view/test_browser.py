"""The windows in a real browser: Debian's Chromium, drawn in software."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from footfall.launch.running import find_graph
from footfall.messages.link import Steer
from footfall.messages.log import LogReader
from footfall.messages.steering import SetSpeed
from footfall.messages.topics import OBJECTIVES, STEERING
from footfall.tools.control import ask
from footfall.tools.log_html import write_html

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium; `apt-get install chromium`"),
]
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield browser
        browser.close()


class Seen:
    """A page, with the addresses it asked for and the errors it had."""

    def __init__(self, browser: Any) -> None:
        self.page = browser.new_page(viewport={"width": 800, "height": 600})
        self.page.set_default_timeout(60_000)
        self.asked: set[str] = set()
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.asked.add(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))

    def outside(self, own: str) -> set[str]:
        """What was asked of anybody else."""
        return {url for url in self.asked if not url.startswith((own, "data:", "blob:"))}


def start(*arguments: object, cwd: Path) -> tuple[subprocess.Popen, str]:
    """Start a command that says what to open; returns its process and the address."""
    process = subprocess.Popen(
        [sys.executable, "-m", "footfall.tools.cli", *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    for line in process.stdout:
        if match := re.search(r"open (http\S+)", line):
            return process, match[1]
    raise AssertionError("ended without an address")


def test_a_log_is_played_in_a_browser(browser, run_log):
    process, url = start("view", run_log, "--port", 0, "--start", 2.0, cwd=run_log.parent)
    try:
        seen = Seen(browser)
        page = seen.page
        page.goto(url)
        page.wait_for_selector("text=yard.mcap")
        page.wait_for_selector("text=Nobody is selected.")
        assert page.locator("canvas").count() >= 1
        page.locator("input[role=combobox][value=nobody]").click()
        page.get_by_role("option", name="#4").click()
        page.wait_for_selector("text=1.00 m/s")
        page.get_by_text("Play / pause").click()
        page.wait_for_function(
            "() => [...document.querySelectorAll('input')].some(i => Number(i.value) >= 3)"
        )
        page.get_by_role("tab", name="Graph").click()
        page.wait_for_selector("td:text-is('planner')")
        assert not page.get_by_text("Share", exact=True).count()
        assert not seen.errors and not seen.outside(url)
        page.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 130


def test_a_running_graph_is_steered_and_the_steering_recorded(browser, tmp_path):
    process, url = start(
        "launch", "corridor", "--set", "count=2", "--view", 0, "--rate", 0.5, "--record", "run.mcap",
        "--run-dir", tmp_path / "r", cwd=tmp_path,
    )  # fmt: skip
    try:
        seen = Seen(browser)
        page = seen.page
        deadline = time.monotonic() + 60
        while True:  # the address is told before the window is there
            try:
                page.goto(url)
                break
            except playwright.Error:
                assert time.monotonic() < deadline
                time.sleep(0.5)
        page.wait_for_selector("text=corridor")
        page.locator("input[role=combobox][value=nobody]").click()
        page.get_by_role("option", name="#0").click()
        page.wait_for_selector("text=wanted speed")
        page.get_by_text("The selected person").click()
        field = page.locator("input[inputmode=decimal]").first
        field.fill("2.2")
        field.press("Enter")
        page.wait_for_selector("text=2.20 m/s")
        ask(find_graph(str(tmp_path / "r")), Steer(SetSpeed(0, 0.75)))
        page.wait_for_selector("text=0.75 m/s")
        page.get_by_text("Pause", exact=True).click()
        time.sleep(1.0)
        assert not seen.errors and not seen.outside(url)
        page.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    reader = LogReader(tmp_path / "run.mcap")
    commands = [item.message.command for item in reader.read(STEERING)]
    assert any(isinstance(c, SetSpeed) and c.agent == 0 and c.speed == pytest.approx(2.2) for c in commands)
    assert SetSpeed(0, 0.75) in commands
    last = list(reader.read(OBJECTIVES))[-1].message
    speeds = {a.id: w.speed for a in last.agents for w in a.objectives if type(w).__name__ == "TargetSpeed"}
    assert speeds[0] == 0.75
    controls = [(item.message.name) for item in reader.messages(["control"])]
    assert "pause" in controls


def test_an_html_replay_needs_no_network(browser, run_log, tmp_path):
    path = write_html(run_log, tmp_path / "yard.html")
    seen = Seen(browser)
    page = seen.page
    page.goto(path.as_uri())
    page.wait_for_selector("body[data-ready=yes]")
    assert page.evaluate("run.times.length") == 41
    page.evaluate("seek(2.5)")
    assert page.evaluate("[...rowOf.keys()]") == [0, 1, 4]
    assert page.evaluate("where(frameAt(run.times, 2.5), 2)") == pytest.approx([0.5, 1.0])
    x, y = page.evaluate("project()([0.5, 1.0, 0.9])")[:2]
    page.mouse.click(x, y)
    page.wait_for_function("() => document.getElementById('info').textContent.includes('#4')")
    page.keyboard.press("ArrowRight")
    assert "2.60 s" in page.inner_text("#time")
    pixels = page.evaluate(
        "(() => { const d = pen.getImageData(0, 0, canvas.width, canvas.height).data;"
        " const s = new Set(); for (let i = 0; i < d.length; i += 4) s.add(d[i] << 16 | d[i + 1] << 8 | d[i + 2]);"
        " return s.size; })()"
    )
    assert pixels > 50  # it is a picture
    page.click("#play")
    page.wait_for_function("() => state.time > 2.9")
    assert not seen.errors and not seen.outside(path.as_uri())
    page.close()
