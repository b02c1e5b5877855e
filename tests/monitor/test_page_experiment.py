"""The page prompts a driver: a real browser, a real prompter, on a phone and on a desk.

`pytest -m browser --refresh` writes the picture of docs/pictures anew.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path

import pytest
from chromium import SOON_MS, serious, with_browser
from loopback import PATIENCE_S
from paths import ROOT
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, ViewportSize, expect
from stage import Monitor, Stage

PICTURES = ROOT / "docs/pictures"
PHONE: ViewportSize = {"width": 390, "height": 844}

expect.set_options(timeout=SOON_MS)
pytestmark = [pytest.mark.browser, with_browser]

PLAN = """
name = "in-the-browser"
machine = "jd7930-parker500"
[field]
length = 4000
width = 400
[[run]]
kind = "chirp"
speed = 2.4
amplitude_deg = 8
seconds = 15
replicates = 2
"""
DRAWN = """() => {
    const bar = document.querySelector("#experiment-bar"), seen = new Set();
    if (!bar.width) return 0;
    const dots = bar.getContext("2d").getImageData(0, 0, bar.width, bar.height).data;
    for (let i = 0; i < dots.length; i += 4) seen.add(dots.slice(i, i + 4).join());
    return seen.size;
}"""


@pytest.fixture
def prompted(tmp_path: Path) -> Iterator[tuple[Monitor, subprocess.Popen[str]]]:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN)
    start = "import sys; from tilth.cli import main; sys.exit(main())"
    with Stage() as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        prompter = subprocess.Popen(
            [sys.executable, "-c", start, "experiment", str(plan), "--connect", stage.endpoint],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        with prompter:
            yield monitor, prompter
            prompter.terminate()
            prompter.communicate(timeout=PATIENCE_S)


def opened(context: BrowserContext, monitor: Monitor) -> Page:
    page = context.new_page()
    page.goto(monitor.url)
    return page


def test_a_driver_is_prompted_on_a_phone(
    browser: Browser,
    prompted: tuple[Monitor, subprocess.Popen[str]],
    request: pytest.FixtureRequest,
) -> None:
    monitor, prompter = prompted
    context = browser.new_context(viewport=PHONE, has_touch=True, is_mobile=True)
    faults: list[str] = []
    context.on("weberror", lambda fault: faults.append(str(fault.error)))
    page = opened(context, monitor)
    part = page.locator("#experiment")
    expect(page.locator("#experiment-title")).to_have_text("Experiment in-the-browser: 0 of 2 runs")
    expect(page.locator("#experiment-text")).to_contain_text("Arm the first run")
    arm, stop, skip = (part.get_by_role("button", name=name) for name in ("Arm this run", "Stop", "Skip"))
    expect(stop).to_be_disabled()
    wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0
    part.get_by_role("button", name="Voice").tap()
    expect(part.get_by_role("button", name="Voice")).to_have_attribute("aria-pressed", "true")
    arm.tap()
    expect(page.locator("#experiment-text")).to_have_text(re.compile("Line up|Ready|Follow"))
    expect(stop).to_be_enabled()
    expect(page.locator("#experiment-conditions li")).to_have_count(4)
    expect(page.locator("#experiment-count")).to_be_visible(timeout=SOON_MS)
    expect(page.locator("#experiment-text")).to_have_text("Follow the bar.", timeout=SOON_MS)
    expect(page.locator("#experiment-angles")).to_contain_text("wanted")
    page.wait_for_function(f"({DRAWN})() > 3", timeout=SOON_MS)
    page.set_viewport_size({"width": 360, "height": 640})
    page.evaluate("scrollTo(0, 0)")
    above, below = page.locator("header").bounding_box(), page.locator(".bar").bounding_box()
    assert above is not None and below is not None
    for button in (arm, stop):  # whatever is between them and the top, they are in reach
        box = button.bounding_box()
        assert box is not None and above["y"] + above["height"] <= box["y"]
        assert box["y"] + box["height"] <= below["y"]
    page.set_viewport_size(PHONE)
    part.scroll_into_view_if_needed()
    if request.config.getoption("--refresh"):
        shot = Image.open(BytesIO(page.screenshot()))
        shot.quantize(200, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
            PICTURES / "page-experiment-phone.png", optimize=True
        )
    stop.tap()
    expect(page.locator("#experiment-attempts")).to_contain_text("aborted, stopped by the driver")
    expect(page.locator("#experiment-text")).to_contain_text("Broken off: stopped by the driver")
    for _ in range(2):
        done = page.locator("#experiment-title").inner_text()
        skip.tap()
        expect(page.locator("#experiment-title")).not_to_have_text(done)
    skipped = "The plan is at its end: 2 of 2 runs were skipped."
    expect(page.locator("#experiment-text")).to_have_text(skipped)
    expect(page.locator("#experiment-title")).to_contain_text("2 of 2 runs, 2 of them skipped")
    expect(page.locator("#experiment-learned")).to_contain_text("No log was heard of")
    expect(part).to_be_hidden(timeout=SOON_MS)  # the prompter has ended
    assert prompter.wait(PATIENCE_S) == 1
    assert not faults
    page.context.close()


def test_it_is_readable_and_an_order_to_nobody_is_refused(
    browser: Browser,
    prompted: tuple[Monitor, subprocess.Popen[str]],
) -> None:
    monitor, prompter = prompted
    page = opened(browser.new_context(), monitor)
    expect(page.locator("#experiment")).to_be_visible()
    assert serious(page, "#experiment") == []
    headers = {"content_type": "application/json"}
    status, answer, _ = monitor.ask("/experiment", b'{"kind": "dance"}', **headers)
    assert (status, "no order; there are arm, stop, skip" in answer) == (200, True)
    assert monitor.ask("/experiment", b'{"kind": "arm"}', content_type="text/plain")[0] == 400
    prompter.terminate()
    prompter.wait(PATIENCE_S)
    expect(page.locator("#experiment")).to_be_hidden(timeout=SOON_MS)
    refused = json.loads(monitor.ask("/experiment", b'{"kind": "arm"}', **headers)[1])
    assert "does not answer" in refused["text"]
    page.context.close()
