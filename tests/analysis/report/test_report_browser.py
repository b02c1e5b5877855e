"""A report in a real browser: light, dark, on a phone, on paper; checked for accessibility.

`pytest -m browser --refresh` writes the picture of docs/pictures anew.
"""

from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from chromium import violations, with_browser
from paths import ROOT
from PIL import Image
from playwright.sync_api import Browser, Page
from report_parts import everything

from tilth.analysis.report.page import page
from tilth.analysis.report.sections import report_of

PICTURE = ROOT / "docs/pictures/report.png"
ON_PAPER = 688  # px between the margins of A4
TOO_WIDE = """(most) => [...document.querySelectorAll("table, svg")]
    .filter((one) => one.getBoundingClientRect().right > most + 1).map((one) => one.id)"""
WIDTHS = {"desktop": 1100, "phone": 390}

pytestmark = [pytest.mark.browser, with_browser]


@pytest.fixture
def file(facts: Any, tmp_path: Path) -> Path:
    path = tmp_path / "a.html"
    report = report_of(everything() | {"runs": [facts], "command": "tilth report field.mcap --out a.html"})
    path.write_text(page(report), encoding="utf-8")
    return path


def opened(browser: Browser, file: Path, width: int, scheme: Any = "light") -> tuple[Page, list[str]]:
    context = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, java_script_enabled=True, offline=True
    )
    faults: list[str] = []
    context.on("console", lambda line: faults.append(line.text))
    context.on("request", lambda asked: faults.append(asked.url) if asked.url != file.as_uri() else None)
    shown = context.new_page()
    shown.goto(file.as_uri())
    return shown, faults


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", WIDTHS)
def test_a_checker_of_accessibility_finds_nothing(
    browser: Browser, file: Path, size: str, scheme: str
) -> None:
    shown, faults = opened(browser, file, WIDTHS[size], scheme)
    found = violations(shown)
    shown.context.close()
    assert [f"{one['id']}: {node['target']}" for one in found for node in one["nodes"]] == []
    assert faults == []


def test_it_fits_the_screen_and_follows_the_scheme(
    browser: Browser, file: Path, request: pytest.FixtureRequest
) -> None:
    grounds = {}
    for scheme in ("light", "dark"):
        for width in WIDTHS.values():
            shown, _ = opened(browser, file, width, scheme)
            assert shown.evaluate("document.documentElement.scrollWidth") <= width
            grounds[scheme] = shown.evaluate("getComputedStyle(document.documentElement).backgroundColor")
            if (scheme, width) == ("light", 1100) and request.config.getoption("--refresh"):
                top = shown.evaluate("document.getElementById('run1-map').getBoundingClientRect().top")
                clip: Any = {"x": 0, "y": top - 10, "width": width, "height": 1500}
                shot = Image.open(BytesIO(shown.screenshot(clip=clip, full_page=True)))
                small = shot.quantize(64, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
                small.save(PICTURE, optimize=True)
            shown.context.close()
    assert grounds == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 22, 26)"}


def test_paper_is_white_and_wide_enough(browser: Browser, file: Path) -> None:
    shown, _ = opened(browser, file, ON_PAPER, "dark")
    shown.emulate_media(media="print")
    ground = shown.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    wide = shown.evaluate(TOO_WIDE, arg=ON_PAPER)
    shown.context.close()
    assert ground == "rgb(255, 255, 255)" and wide == []
