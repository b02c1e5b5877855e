"""The page guides a driver through a calibration: a real browser, a real daemon, `tilth calibrate --live`.

`pytest -m browser --refresh` writes the picture of docs/pictures anew.
"""

import os
import re
from collections.abc import Iterator
from contextlib import closing
from importlib import resources
from io import BytesIO
from pathlib import Path

import pytest
from field_rig import FieldRig
from live_rig import PARKED, calibrating, drive_before
from paths import ROOT
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright
from stage import Monitor

CHROMIUM = Path(os.environ.get("TILTH_CHROMIUM", "/usr/bin/chromium-headless-shell"))
PICTURES = ROOT / "docs/pictures"
SOON_MS = 60_000

expect.set_options(timeout=SOON_MS)
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not CHROMIUM.exists(), reason=f"no browser at {CHROMIUM}; set TILTH_CHROMIUM"),
]
SHARES = "(bars) => bars.map((bar) => bar.value)"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        one = playwright.chromium.launch(executable_path=CHROMIUM)
        yield one
        one.close()


def picture(page: Page, to: Path) -> None:
    shot = Image.open(BytesIO(page.locator("#calibration").screenshot()))
    shot.quantize(200, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(to, optimize=True)


def test_a_driver_sees_what_to_do_what_is_known_and_orders(
    browser: Browser, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    with closing(FieldRig(tmp_path, 60.0, PARKED)) as rig:
        rig.start()
        drive_before(rig)
        with closing(Monitor("--connect", rig.endpoint)) as monitor:
            page = browser.new_context(viewport={"width": 1100, "height": 1400}).new_page()
            faults: list[str] = []
            page.context.on("weberror", lambda fault: faults.append(str(fault.error)))
            page.goto(monitor.url)
            expect(page.locator("#run-word")).to_have_text(re.compile("RECORDING|PREPARING"))
            with calibrating("--connect", rig.endpoint):
                _guided(page)
                _ordered(page, request.config.getoption("--refresh"))
            assert not faults
            page.context.close()


def _guided(page: Page) -> None:
    """Before anything is computed."""
    part = page.locator("#calibration")
    expect(page.locator("#calibration-title")).to_have_text("Calibrating jd7930-parker500")
    expect(page.locator("#calibration-text")).to_have_text(re.compile("^(Stand still for|Drive straight,) "))
    expect(page.locator("#calibration-happening")).to_have_text("This counts for: Park.")
    expect(page.locator(".calibration-stage")).to_have_count(5)
    shares = page.locator(".calibration-stage progress").evaluate_all(SHARES)
    assert len(shares) == 5 and all(0.0 <= share <= 1.0 for share in shares) and 0.0 < shares[1] < 1.0
    expect(page.locator("#calibration-computed")).to_contain_text("The next estimate begins after")
    expect(page.locator("#calibration-numbers")).to_be_hidden()
    axe = resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    page.evaluate(f"() => {{ {axe} }}")
    expect(part.get_by_role("button", name="Compute now")).to_be_enabled()


def _ordered(page: Page, refresh: bool) -> None:
    part = page.locator("#calibration")
    part.get_by_role("button", name="Compute now").click()
    expect(page.locator("#calibration-told")).to_have_text(re.compile("^✔"))
    expect(page.locator("#calibration-computed")).to_contain_text("Computing with")
    expect(page.locator("#calibration-rows tr")).to_have_count(16)
    expect(page.locator("#calibration-rows tr").first).to_contain_text("yaw of the tractor's pair")
    found = page.evaluate("axe.run('#calibration').then((found) => found.violations)")
    assert [one["id"] for one in found if one["impact"] in ("serious", "critical")] == []
    if refresh:
        picture(page, PICTURES / "page-calibration.png")
    page.set_viewport_size({"width": 390, "height": 844})
    wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0
    picture(page, Path("/tmp/w/livetmp/phone.png"))
    finish = page.locator("#calibration-finish")
    finish.click()
    expect(finish).to_have_text("Finish: tap again")
    finish.click()
    expect(page.locator("#calibration-text")).to_contain_text("Finished.")
    expect(finish).to_be_disabled()
