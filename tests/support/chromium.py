"""The browser of the tests of pages: where it is, how it is started, and what a page has against it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM = Path(os.environ.get("TILTH_CHROMIUM", "/usr/bin/chromium-headless-shell"))
SOON_MS = 180_000  # a busy computer takes its time; a quiet one does not wait
with_browser = pytest.mark.skipif(
    not CHROMIUM.exists(), reason=f"no browser at {CHROMIUM}; set TILTH_CHROMIUM"
)


@contextmanager
def launched() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        one = playwright.chromium.launch(executable_path=CHROMIUM)
        yield one
        one.close()


def violations(page: Page, selector: str = "html") -> list[dict[str, Any]]:
    """Of the rules of accessibility, in what the selector finds: id, impact and nodes of each."""
    axe = resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    page.evaluate(f"() => {{ {axe} }}")
    found: list[dict[str, Any]] = page.evaluate(
        "(of) => axe.run(of).then((found) => found.violations)", selector
    )
    return found


def serious(page: Page, selector: str = "html") -> list[str]:
    """Those that keep people from using it: rule, element and what is wrong with it."""
    return [
        f"{one['id']}: {node['target']} {node['failureSummary']}"
        for one in violations(page, selector)
        if one["impact"] in ("serious", "critical")
        for node in one["nodes"]
    ]
