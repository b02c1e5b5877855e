"""The page guides a driver through a calibration: a real browser, a real daemon, `tilth calibrate --live`.

`pytest -m browser --refresh` writes the picture of docs/pictures anew.
"""

import re
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from chromium import SOON_MS, serious, with_browser
from field_rig import FieldRig
from live_rig import PARKED, calibrating, drive_before
from paths import ROOT
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from stage import Monitor

from tilth.estimator.calibration.sought_numbers import SOUGHT

PICTURE = ROOT / "docs/pictures/page-calibration.png"
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}

expect.set_options(timeout=SOON_MS)
pytestmark = [pytest.mark.browser, with_browser]
SHARES = "(bars) => bars.map((bar) => bar.value)"
FILLED = "(bars) => bars.map((bar) => parseFloat(getComputedStyle(bar).backgroundSize))"


def opened(browser: Browser, monitor: Monitor, faults: list[str], **options: Any) -> Page:
    context = browser.new_context(**options)
    context.on("weberror", lambda fault: faults.append(str(fault.error)))
    page = context.new_page()
    page.goto(monitor.url)
    return page


def test_a_driver_sees_what_to_do_what_is_known_and_orders(
    browser: Browser, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    faults: list[str] = []
    with closing(FieldRig(tmp_path, 60.0, PARKED)) as rig:
        rig.start()
        drive_before(rig)
        with closing(Monitor("--connect", rig.endpoint)) as monitor:
            page = opened(browser, monitor, faults, viewport={"width": 1000, "height": 1150})
            expect(page.locator("#run-word")).to_have_text(re.compile("RECORDING|PREPARING"))
            with calibrating("--connect", rig.endpoint):
                _guided(page)
                _computed(page)
                if request.config.getoption("--refresh"):
                    _picture(page)
                _readable(page)
                _finished(opened(browser, monitor, faults, **PHONE))
                expect(page.locator("#calibration-text")).to_contain_text("Finished.")
    assert not faults
    for context in browser.contexts:
        context.close()


def _guided(page: Page) -> None:
    """Before anything is computed."""
    expect(page.locator("#calibration-title")).to_have_text("Calibrating jd7930-parker500")
    expect(page.locator("#calibration-text")).to_have_text(re.compile("^(Stand still for|Drive straight,) "))
    expect(page.locator("#calibration-happening")).to_have_text("This counts for: Park.")
    expect(page.locator(".calibration-stage")).to_have_count(5)
    shares = page.locator(".calibration-stage progress").evaluate_all(SHARES)
    assert len(shares) == 5 and all(0.0 <= share <= 1.0 for share in shares) and 0.0 < shares[1] < 1.0
    expect(page.locator("#calibration-computed")).to_contain_text("The next estimate begins after")
    for part in ("#calibration-numbers", "#calibration-left", ".calibration-beside >> nth=4"):
        expect(page.locator(part)).to_be_hidden()


def _computed(page: Page) -> None:
    page.get_by_role("button", name="Compute now").click()
    expect(page.locator("#calibration-told")).to_have_text(re.compile("^✔"))
    expect(page.locator("#calibration-computed")).to_contain_text("Computing with")
    rows = page.locator("#calibration-rows tr")
    expect(rows).to_have_count(len(SOUGHT))
    expect(rows.first).to_contain_text("yaw of the tractor's pair")
    expect(page.locator("#calibration-rows tr[data-status=told]").first).to_contain_text("✔ good")
    # How many numbers so short a drive tells only roughly is a matter of a hair: perhaps none.
    for text in page.locator("#calibration-rows tr[data-status=rough] th").all_inner_texts():
        assert re.search(r"change of the file: .* ± .*\w[^;]*(drive|weave|a tape)", text), text
    missing = page.locator("#calibration-rows tr[data-status='not told'] th").all_inner_texts()
    assert missing and not any("change of the file" in text for text in missing)
    expect(page.locator("#calibration-computed")).to_have_text(
        re.compile("^Computed by .* The next estimate begins after 120 s more of driving")
    )
    left = page.locator("#calibration-left-rows li")
    expect(left.first).to_have_text(re.compile("^positions.*✔ as expected$"))
    bars = left.locator(".calibration-bar").evaluate_all(FILLED)
    assert len(bars) >= 4 and all(0.0 < filled < 50.0 for filled in bars)  # %; the mark stands at a third
    expect(page.locator(".calibration-beside >> nth=4")).to_contain_text("automatic steering never steered")
    sentences = page.locator("#calibration-sentences")
    expect(sentences).to_contain_text("numbers are known as well as is wanted")
    expect(sentences).not_to_contain_text("No numbers yet")


def _picture(page: Page) -> None:
    page.evaluate("window.scrollTo(0, 0)")
    shot = Image.open(BytesIO(page.screenshot()))
    shot.quantize(200, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        PICTURE, optimize=True
    )


def _readable(page: Page) -> None:
    assert serious(page, "#calibration") == []


def _finished(phone: Page) -> None:
    """A second tap is wanted."""
    expect(phone.locator("#calibration-rows tr")).to_have_count(len(SOUGHT))  # who comes later sees the same
    for wide in ("document.documentElement", "document.querySelector('#calibration-numbers')"):
        assert phone.evaluate(f"{wide}.scrollWidth - {wide}.clientWidth") <= 0
    finish = phone.locator("#calibration-finish")
    finish.tap()
    expect(finish).to_have_text("Finish: tap again")
    finish.tap()
    expect(phone.locator("#calibration-text")).to_contain_text("Finished.")
    expect(finish).to_be_disabled()
