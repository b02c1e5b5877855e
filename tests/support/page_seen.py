"""What a person sees of the page, in whichever test of it."""

import re
from io import BytesIO
from typing import Any

import pytest
from chromium import SOON_MS
from paths import ROOT
from PIL import Image
from playwright.sync_api import Page, expect

PICTURES = ROOT / "docs/pictures"
SIZES: dict[str, dict[str, Any]] = {
    "desktop": {"viewport": {"width": 1440, "height": 900}},
    "tablet": {"viewport": {"width": 1024, "height": 768}, "has_touch": True},
    "phone": {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True},
}


def expect_run(page: Page, words: str, state: str) -> None:
    expect(page.locator("#run-word")).to_have_text(re.compile(words), timeout=SOON_MS)
    expect(page.locator("#run")).to_have_attribute("data-state", state)


OLD = """(kinds) => [...document.querySelectorAll("[data-live]")].every((part) =>
    !part.checkVisibility() || [...part.querySelectorAll(".age")].every(({ textContent: age }) =>
        kinds.includes(part.dataset.live) ? /^[\\d.]+ (s|min|h) old$/.test(age) : !age)
)"""


def expect_old(page: Page, *kinds: str) -> None:
    """Every part of the page that lives on those messages says how old it is; no other does."""
    page.wait_for_function(OLD, arg=kinds, timeout=SOON_MS)
    assert page.locator("[data-live] .age").count() >= page.locator("[data-live]").count() > 6


def picture(request: pytest.FixtureRequest, page: Page, name: str) -> None:
    if request.config.getoption("--refresh"):
        PICTURES.mkdir(exist_ok=True)
        shot = Image.open(BytesIO(page.screenshot(full_page=not name.endswith("phone"))))
        shot.quantize(200, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
            PICTURES / f"{name}.png", optimize=True
        )
