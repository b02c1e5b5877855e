"""A machine file made on a phone, while a rig drives on a bus of this computer; the page offline."""

import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from chromium import SOON_MS, serious, with_browser
from page_seen import SIZES, expect_old, expect_run, picture
from playwright.sync_api import Browser, Page, expect
from setting_up import CODE, SettingUp
from stage import Monitor, Stage

from tilth.logger.machine_file import read_machine
from tilth.monitor.addresses import network_addresses

pytestmark = [pytest.mark.browser, with_browser]

LENGTHS = {"name": "jd7930", "tractor.wheelbase": "2,9", "tractor.hitch": "0.9", "implement.drawbar": "3.72"}
MASSES = {"tractor.mass": "9391", "implement.mass": "2127"}
AHEAD = {"Tractor front": "2.8", "Tractor rear": "0.1", "Implement front": "1.4", "Implement rear": "-1.2"}


@pytest.fixture
def setting(tmp_path: Path) -> Iterator[SettingUp]:
    with closing(SettingUp(tmp_path)) as one, one.driving(tmp_path, 500.0):
        yield one


def test_from_a_code_to_a_checked_machine_file(
    browser: Browser, setting: SettingUp, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    context = browser.new_context(**SIZES["phone"])
    page, told = context.new_page(), list[str]()
    context.on("weberror", lambda fault: told.append(str(fault.error)))
    page.goto(setting.url)
    found = [serious(page)]
    page.get_by_role("textbox").fill("ABCD-2346")
    page.get_by_role("button").click()
    expect(page.get_by_role("alert")).to_contain_text("not the code")
    enter(page)

    following = page.get_by_role("button", name="Next")
    expect(page.locator("#receivers > li")).to_have_count(4, timeout=SOON_MS)
    found.append(serious(page))
    following.click()
    expect(page.locator("#proposed")).to_be_visible(timeout=SOON_MS)
    for card in page.locator("#receivers > li").all():
        mount = card.get_by_label("Mounted").evaluate("(one) => one.selectedOptions[0].text")
        for label, text in (("ahead of", AHEAD[mount]), ("right of", "0"), ("above", "2.9")):
            card.get_by_label(label).fill(text)
    page.get_by_label("ahead of").first.focus()
    expect(page.locator(".antenna [data-lit]")).to_have_count(1)
    found.append(serious(page))
    following.click()
    fill(page, LENGTHS)
    expect(page.locator("[data-dim='implement.drawbar'][data-lit]")).to_have_count(1)
    found.append(serious(page))
    picture(request, page, "page-setup-phone")
    following.click()
    fill(page, MASSES | {"tractor.mass": "93910"})
    following.click()
    page.get_by_label("0x18FF0B15").check(timeout=SOON_MS)
    page.get_by_label("I know the scale").check()
    fill(page, {"wheel.scale": "0.01"})
    found.append(serious(page))

    following.click()
    expect(page.locator("#wrongs")).to_contain_text("must be from 500 to 40000", timeout=SOON_MS)
    expect(page.locator("#save")).to_be_hidden()
    page.reload()  # what was written is there again, also in another language
    page.locator("#language").click()
    page.get_by_role("button", name="Massen").click()
    fill(page, MASSES)
    expect(page.locator("#receivers > li")).to_have_count(4, timeout=SOON_MS)
    page.get_by_role("button", name="Prüfen", exact=True).click()
    expect(page.locator("#save")).to_be_visible(timeout=SOON_MS)
    expect(page.locator("#passed")).to_contain_text("configuration: jd7930", timeout=SOON_MS)
    found.append(serious(page))
    page.locator("#save").click()
    expect(page.locator("#saved")).to_contain_text("✔ Gespeichert", timeout=SOON_MS)
    machine = read_machine(setting.file).machine
    assert machine.tractor.wheelbase == pytest.approx(2.9) and len(machine.receiver) == 4
    page.locator("#save").evaluate("(button) => { button.hidden = false; }")
    page.locator("#save").click()
    expect(page.locator("#saved")).to_contain_text("machine.toml.before", timeout=SOON_MS)
    page.get_by_role("link", name="Anzeige öffnen").click()
    expect(page.locator("#run-word")).to_be_visible()
    expect(page.locator("#setup")).to_be_visible(timeout=SOON_MS)
    context.close()
    assert found == [[]] * len(found) and not told


def enter(page: Page) -> None:
    """A try that comes too soon after another one is taken anew."""
    while not page.url.endswith("/setup"):
        page.get_by_role("textbox").fill(CODE.lower())
        page.get_by_role("button").click()
        page.wait_for_load_state()


def fill(page: Page, answers: dict[str, str]) -> None:
    for name, text in answers.items():
        page.locator(f"[name='{name}']").fill(text)


def test_while_the_network_is_away_the_page_opens_with_what_was_last(browser: Browser) -> None:
    """Old is old: no number of before is shown as live, and with the network all is live again."""
    with Stage(rate=10.0) as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        context = browser.new_context(**SIZES["phone"])
        page = context.new_page()
        page.goto(monitor.url)
        expect_run(page, "● RECORDING", "good")
        expect(page.locator("#map-words")).to_contain_text("receivers", timeout=SOON_MS)
        page.evaluate("() => navigator.serviceWorker.ready.then(() => true)")
        page.reload()  # now by way of the worker, which keeps what it fetches
        expect_run(page, "● RECORDING", "good")
        context.set_offline(True)
        monitor.close()
        page.reload()
        expect_run(page, "NO CONNECTION", "bad")
        expect(page.locator("#machine")).to_have_text("jd7930-parker500")
        expect(page.locator("#run-time")).to_contain_text("for")
        expect_old(page, "status", "pose", "soil_tire")
        context.set_offline(False)
        port = int(monitor.address.rpartition(":")[2])
        with closing(Monitor("--connect", stage.endpoint, port=port)):
            expect_run(page, "● RECORDING", "good")
            expect_old(page)
            context.close()


@pytest.mark.skipif(not network_addresses(), reason="this computer has no address in a network")
def test_over_plain_http_the_page_is_live_and_is_no_app(browser: Browser) -> None:
    """As browsers have it; what the page does without the worker is its own."""
    with (
        Stage(rate=10.0) as stage,
        closing(Monitor("--connect", stage.endpoint, "--host", network_addresses()[0])) as monitor,
    ):
        context = browser.new_context(**SIZES["phone"])
        page = context.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(monitor.url)
        expect_run(page, "● RECORDING", "good")
        assert page.evaluate("() => [isSecureContext, 'serviceWorker' in navigator]") == [False, False]
        context.set_offline(True)
        expect_run(page, "NO CONNECTION", "bad")
        context.set_offline(False)
        expect_run(page, "● RECORDING", "good")  # an open page keeps running
        assert errors == []
        context.close()


def test_a_phone_without_the_code_sees_nothing_of_the_live_page(browser: Browser, tmp_path: Path) -> None:
    with closing(SettingUp(tmp_path)) as one:
        page = browser.new_context(**SIZES["phone"]).new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(one.url)
        expect(page.get_by_role("textbox")).to_be_visible()
        assert [url for url in asked if not url.endswith("favicon.ico")] == [one.url]
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(f"{one.url}main.js")
        page.context.close()
