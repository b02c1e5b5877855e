"""The page in a real browser: what a person sees, touches and types, with a real daemon behind it.

`pytest -m browser --refresh` writes the pictures of docs/pictures anew.
"""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from chromium import SOON_MS, serious, with_browser
from client_daemon import until
from field_rig import FieldRig
from loopback import PATIENCE_S
from page_seen import SIZES, expect_old, expect_run, picture
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, expect
from stage import Monitor, Stage

from tilth.simulator.scenario import DrivenManoeuvre, Scenario, Soil, SoilChange

MOUNTS = ("Tractor front", "Tractor rear", "Implement front", "Implement rear", "Wheel angle")
REPORT_MS = 3 * SOON_MS  # behind all else
COLOURS_OF_THE_MAP = """(() => {
    const map = document.querySelector("#map"), seen = new Set();
    const dots = map.getContext("2d").getImageData(0, 0, map.width, map.height).data;
    for (let i = 0; i < dots.length; i += 4) seen.add(dots.slice(i, i + 3).join());
    return seen.size;
})()"""

expect.set_options(timeout=SOON_MS)

pytestmark = [pytest.mark.browser, with_browser]


@pytest.fixture(scope="module")
def stage() -> Iterator[tuple[Stage, Monitor]]:
    with Stage(rate=10.0) as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        yield stage, monitor


class Faults:
    """Whatever a page complains of, and whatever it asks elsewhere."""

    def __init__(self, context: BrowserContext, address: str) -> None:
        self.told: list[str] = []
        context.on("weberror", lambda fault: self.told.append(str(fault.error)))
        context.on("console", self._said)
        context.on("request", lambda requested: self._asked(requested.url, address))

    def _said(self, line: ConsoleMessage) -> None:
        if line.type == "error":
            self.told.append(line.text)

    def _asked(self, url: str, address: str) -> None:
        if not re.match(rf"(http|ws)://{re.escape(address)}/|data:|blob:", url):
            self.told.append(f"asked elsewhere: {url}")


def opened(browser: Browser, monitor: Monitor, size: str = "desktop", **options: Any) -> tuple[Page, Faults]:
    context = browser.new_context(**(SIZES[size] | options))
    faults = Faults(context, monitor.address)
    page = context.new_page()
    page.goto(monitor.url)
    return page, faults


def state_of(page: Page, name: str) -> Any:
    return page.locator(".tile", has=page.get_by_role("heading", name=name, exact=True))


LIVE = ("status", "pose", "soil_tire")


def test_a_run_in_the_field(browser: Browser, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """One daemon, one page that is never reloaded: nothing yet, nothing, all well, a receiver lost and back,
    recording stopped and again, the daemon killed and again, the page's server killed and again."""
    with closing(FieldRig(tmp_path, 900.0)) as rig:
        monitor = Monitor("--connect", rig.endpoint)
        page, faults = opened(browser, monitor)
        expect_no_daemon(page, request)
        rig.start()
        expect_run(page, "RECORDING", "good")
        for name in MOUNTS:
            expect(state_of(page, name)).to_have_attribute("data-state", "good", timeout=SOON_MS)
        expect(page.locator("#map-words")).to_contain_text("4 of 4 receivers", timeout=SOON_MS)
        expect(page.locator("#map-words")).to_contain_text("tractor leans", timeout=SOON_MS)
        expect(page.locator("#map-words")).to_contain_text("slope down", timeout=SOON_MS)
        assert not faults.told

        expect_a_lost_receiver(page, rig, request)
        rig.let_it_write(False)
        expect_run(page, "NOT RECORDING", "bad")
        assert page.title().endswith("NOT RECORDING")
        expect(page.locator("#problems")).to_contain_text("Not recording: ", timeout=SOON_MS)
        picture(request, page, "page-not-recording")
        rig.let_it_write(True)

        expect_run(page, "● RECORDING", "good")

        expect_a_mark(page)
        expect_a_report(page)

        rig.kill()
        expect_run(page, "DAEMON GONE", "bad")
        expect(state_of(page, "Tractor front")).to_have_attribute("data-state", "unknown")
        expect(state_of(page, "Tractor front")).to_contain_text("was alive")
        expect(page.locator("#map-words")).to_contain_text("4 of 4 receivers")
        expect_old(page, *LIVE)
        picture(request, page, "page-daemon-gone")
        rig.start()
        expect_run(page, "● RECORDING", "good")

        monitor.close()
        expect_run(page, "NO CONNECTION", "bad")
        with closing(Monitor("--connect", rig.endpoint, port=int(monitor.address.rpartition(":")[2]))):
            expect_run(page, "● RECORDING", "good")
            page.context.close()


def expect_no_daemon(page: Page, request: pytest.FixtureRequest) -> None:
    """Nothing is heard yet: first it waits, then it says so."""
    expect_run(page, "WAITING", "wait")
    expect(page.locator("#problems")).to_be_hidden()
    expect(page.locator("#preparing")).to_have_text("Waiting for the daemon: it may have just been started.")
    expect_run(page, "NO DAEMON", "bad")
    expect(page.locator("#problems")).to_contain_text("No daemon is heard")
    picture(request, page, "page-no-daemon")


def expect_a_lost_receiver(page: Page, rig: FieldRig, request: pytest.FixtureRequest) -> None:
    """One is unplugged and plugged in again."""
    rig.unplug("implement_rear")
    lost = state_of(page, "Implement rear")
    expect(lost).to_have_attribute("data-state", "bad", timeout=SOON_MS)
    expect(lost).to_contain_text("LOST")
    expect(page.locator("#problems")).to_contain_text("no longer heard; check power and plug")
    expect(page.locator("#events")).to_contain_text("implement_rear", timeout=SOON_MS)
    picture(request, page, "page-receiver-lost")
    rig.unplug()
    expect(lost).to_have_attribute("data-state", "good", timeout=SOON_MS)
    expect(lost).to_contain_text("was lost until")


def expect_a_mark(page: Page) -> None:
    """Typed, with the key that opens it, and found among the events."""
    page.keyboard.press("m")
    page.keyboard.type("wet spot begins")
    page.keyboard.press("Enter")
    expect(page.locator("#mark-told")).to_have_text("✔ Written to the log.", timeout=SOON_MS)
    expect(page.locator("#events")).to_contain_text("wet spot begins", timeout=SOON_MS)
    page.keyboard.press("Escape")


def expect_a_report(page: Page) -> None:
    """The button makes one of the run so far; it opens beside the page, which goes on."""
    page.get_by_role("button", name="Report of this run so far").click()
    expect(page.locator("#report-told")).to_contain_text("Open the report", timeout=REPORT_MS)
    with page.expect_popup() as opens:
        page.get_by_role("link", name="Open the report").click()
    expect(opens.value.locator("h1")).to_contain_text("jd7930-parker500")
    expect(opens.value.locator("svg").first).to_be_visible()
    opens.value.close()
    expect_run(page, "● RECORDING", "good")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_checker_of_accessibility_finds_nothing_serious(
    browser: Browser, stage: tuple[Stage, Monitor], size: str, scheme: str
) -> None:
    page, _ = opened(browser, stage[1], size, color_scheme=scheme)
    expect_run(page, "RECORDING", "good")
    stage[0].order(lost="implement_rear", event="lost", text="implement_rear gives no usable position")
    expect(state_of(page, "Implement rear")).to_have_attribute("data-state", "bad", timeout=SOON_MS)
    found = [serious(page)]
    stage[0].order(invalid="why", preparing="compiling", refusal="the disk is full")
    expect(page.locator("#withdrawn")).to_be_visible(timeout=SOON_MS)
    page.locator("[data-mark=soft]").click()
    expect(page.locator("#marks-told")).to_contain_text("the disk is full")
    found.append(serious(page))
    stage[0].order(silent=True, invalid="", preparing="", refusal="")
    expect(page.locator("#soil[data-old]")).to_be_visible(timeout=SOON_MS)
    found.append(serious(page))
    page.locator("#mark").click()
    found.append(serious(page))
    stage[0].order(lost="", silent=False)
    page.context.close()
    assert found == [[]] * 4


def test_a_mark_by_keyboard_and_by_touch(browser: Browser, stage: tuple[Stage, Monitor]) -> None:
    for size in ("desktop", "phone"):
        page, _ = opened(browser, stage[1], size)
        expect_run(page, "RECORDING", "good")
        if size == "phone":
            page.locator("#mark").tap()
            page.locator("#mark-text").fill(f"wet spot {size}")
            page.locator("#mark-send").tap()
        else:
            page.keyboard.press("m")
            page.keyboard.type(f"wet spot {size}")
            page.keyboard.press("Enter")
        expect(page.locator("#mark-told")).to_have_text("✔ Written to the log.")
        page.keyboard.press("Escape")
        expect(page.locator("dialog")).to_be_hidden()
        expect(page.locator("#events")).to_contain_text(f"wet spot {size}")
        page.keyboard.press("m")
        page.locator("#mark-text").fill("ü" * 600)
        page.keyboard.press("Enter")
        expect(page.locator("#mark-told")).to_have_text("✘ This note has 1200 bytes; 1024 are the most.")
        page.context.close()


def test_one_tap_is_a_mark_and_a_refusal_says_why(browser: Browser) -> None:
    with Stage() as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        page, _ = opened(browser, monitor, "phone")
        expect_run(page, "RECORDING", "good")
        result = page.locator("#marks-told p")
        for text in ("soft", "wet", "stone", "turn"):
            page.get_by_role("button", name=f"Mark: {text}").tap()
            expect(result.filter(has_text=f"{text}: ✔ Written to the log.")).to_be_in_viewport()
            expect(page.locator("#events li", has_text=f"mark {text}")).to_have_count(1)
        expect(result).to_have_count(0, timeout=SOON_MS)  # what is in the log need not be said for ever
        stage.order(refusal="the disk is full")
        until(lambda: monitor.mark("once more")["text"] == "the disk is full")
        page.get_by_role("button", name="Mark: wet").tap()
        expect(result).to_have_text("wet: ✘ Not in the log: the disk is full")
        stage.order(refusal="")
        until(lambda: monitor.mark("once more")["noted"])
        page.get_by_role("button", name="Mark: soft").tap()
        expect(result).to_have_text(
            ["wet: ✘ Not in the log: the disk is full", "soft: ✔ Written to the log."]
        )
        page.get_by_role("button", name="Mark: wet").tap()
        expect(result.filter(has_text="✘")).to_have_count(0)
        monitor.process.send_signal(signal.SIGSTOP)
        expect_run(page, "NO CONNECTION", "bad")
        page.get_by_role("button", name="Mark: turn").tap()
        expect(result.filter(has_text="turn")).to_have_text("turn: asking the daemon …")
        monitor.process.send_signal(signal.SIGCONT)
        expect(result.filter(has_text="turn")).to_have_text("turn: ✔ Written to the log.", timeout=SOON_MS)
        page.context.close()


def test_an_implement_is_chosen_on_the_page(browser: Browser) -> None:
    with Stage() as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        page, faults = opened(browser, monitor, "phone")
        expect_run(page, "RECORDING", "good")
        choice = page.locator("#implement select")
        expect(choice).to_be_hidden()  # the tractor has one alone
        stage.order(implements=["parker", "krampe", "slurry"])
        expect(choice).to_have_value("parker")
        choice.select_option("slurry")
        expect(page.locator("#implement")).to_contain_text("✘ Not changed: no implement slurry")
        expect(choice).to_have_value("parker")
        choice.select_option("krampe")
        expect(choice).to_have_value("krampe")
        expect(page.locator("#implement output")).to_have_text("")  # the daemon says that it is so
        assert faults.told == []
        page.context.close()


def test_what_the_implement_carries_is_said_by_a_tap(browser: Browser) -> None:
    with Stage() as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        page, faults = opened(browser, monitor, "phone")
        expect_run(page, "RECORDING", "good")
        expect(page.locator("#load")).to_be_hidden()
        stage.order(load=-1.0)
        expect(page.locator("#load")).to_contain_text("load not known (full: 6.0 t)")
        page.locator("#load button", has_text="full").click()
        expect(page.locator("#load")).to_contain_text("carries 6.0 t ± 0.6 t")
        page.locator("#load button", has_text="empty").click()
        expect(page.locator("#load")).to_contain_text("carries 0.0 t ± 0.6 t")
        assert faults.told == []
        page.context.close()


def test_what_has_been_moved_is_accepted_by_a_tap(browser: Browser) -> None:
    with Stage() as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        page, faults = opened(browser, monitor, "phone")
        expect_run(page, "RECORDING", "good")
        box = page.locator("#moved")
        expect(box).to_be_hidden()
        stage.order(moved=["tractor_front", "pair_tractor"])
        expect(box).to_contain_text("Tractor_front has been moved 0.10 m forward. Put it back, or accept")
        box.get_by_role("button", name="accept tractor front").tap()
        expect(box).to_be_hidden()  # the daemon says that it is accepted
        assert faults.told == []
        page.context.close()


@pytest.mark.parametrize(
    ("who", "how", "word"),
    [
        ("daemon", signal.SIGSTOP, "SILENT|DAEMON GONE"),
        ("daemon", signal.SIGKILL, "DAEMON GONE"),
        ("server", signal.SIGSTOP, "NO CONNECTION"),
        ("server", signal.SIGKILL, "NO CONNECTION"),
    ],
)
def test_nothing_is_shown_as_now_when_its_sender_is_gone(
    browser: Browser, who: str, how: signal.Signals, word: str
) -> None:
    with Stage(rate=2.0) as stage:
        monitor = Monitor("--connect", stage.endpoint)
        page, _ = opened(browser, monitor)
        expect_run(page, "RECORDING", "good")
        expect(page.locator("#speed")).to_have_text("8.6 km/h", timeout=SOON_MS)
        expect(page.locator("#ground")).to_contain_text("as usual", timeout=SOON_MS)
        expect_old(page)
        gone = stage.process if who == "daemon" else monitor.process
        gone.send_signal(how)
        try:
            expect_run(page, word, "bad")
            expect_old(page, *LIVE)
            expect(page.locator("#speed")).to_have_text("8.6 km/h")
            expect(page.locator("#map")).to_have_css("filter", "grayscale(1)")
            expect(page.locator(".trace-status").first).to_have_text("stale")
            assert page.title().endswith(page.locator("#run-word").inner_text())
        finally:
            gone.send_signal(signal.SIGCONT)  # else it could not even be ended
        if how == signal.SIGSTOP:
            expect_run(page, "RECORDING", "good")
            expect_old(page)
        page.context.close()
        if gone is monitor.process and how == signal.SIGKILL:
            monitor.process.communicate()
        else:
            monitor.close()


def test_a_daemon_that_prepares_is_waited_for_in_words(
    browser: Browser, stage: tuple[Stage, Monitor], request: pytest.FixtureRequest
) -> None:
    page, _ = opened(browser, stage[1])
    expect_run(page, "● RECORDING", "good")
    output = page.locator("#preparing")
    expect(output).to_be_hidden()
    stage[0].order(preparing="compiling", ready_in_s=40.0)
    expect(output).to_have_text(
        "Compiling, about 40 s left. Frames are already being recorded; results will follow.", timeout=SOON_MS
    )
    expect_run(page, "● RECORDING", "good")
    picture(request, page, "page-preparing")
    stage[0].order(ready_in_s=None, recording=False)
    expect(output).to_have_text("Compiling. Results will follow.", timeout=SOON_MS)
    expect_run(page, "NOT RECORDING", "bad")
    stage[0].order(preparing="", recording=True)
    expect(output).to_be_hidden(timeout=SOON_MS)
    page.context.close()


def test_numbers_that_are_withdrawn_are_said_with_the_reason(
    browser: Browser, stage: tuple[Stage, Monitor], request: pytest.FixtureRequest
) -> None:
    page, _ = opened(browser, stage[1])
    why = "the wheel angle has the opposite sign of the yaw rate: wheel_angle.sign?"
    expect(page.locator("#ground")).to_contain_text("as usual", timeout=SOON_MS)
    expect(page.locator("#withdrawn")).to_be_hidden()
    stage[0].order(invalid=why, flag="contradiction:wheel_angle.sign", event="contradiction", text=why)
    expect(page.locator("#withdrawn-why")).to_have_text(f"Numbers withdrawn: {why}", timeout=SOON_MS)
    expect(page.locator("#withdrawn")).to_be_in_viewport()
    expect(page.locator("#ground strong")).to_have_text([re.compile("withdrawn")] * 3)
    expect(page.locator(".trace-value")).to_have_text(["– kN/rad"] * 3 + ["– m"] * 3)
    expect(page.locator("#map-words")).to_contain_text("contradicts the machine file: wheel_angle.sign")
    expect(page.locator("#events")).to_contain_text("contradiction")
    expect(page.locator("#advice")).not_to_contain_text("steering")
    picture(request, page, "page-withdrawn")
    stage[0].order(invalid="", flag="")
    expect(page.locator("#withdrawn")).to_be_hidden(timeout=SOON_MS)
    page.context.close()


def test_a_phone_has_the_soil_at_once_and_all_else_by_one_tap(
    browser: Browser, stage: tuple[Stage, Monitor]
) -> None:
    page, _ = opened(browser, stage[1], "phone")
    expect(page.locator("#ground li")).to_have_count(3, timeout=SOON_MS)
    expect(page.locator("#ground")).to_contain_text("as usual", timeout=SOON_MS)
    under = page.locator(".bar").bounding_box()
    assert under is not None and under["y"] + under["height"] <= 845
    for one in [page.locator("#soil-title"), *page.locator("#ground li").all()]:
        box = one.bounding_box()
        assert box is not None and box["y"] > 0 and box["y"] + box["height"] < under["y"]
    parts = {"Sensors": "#tiles", "Field": "#map", "Events": "#events", "Soil": "#soil-title"}
    for link, part in parts.items():
        page.get_by_role("link", name=link).tap()
        expect(page.locator(part)).to_be_in_viewport(ratio=0.5)
    page.context.close()


def test_a_phone_makes_an_app_of_it(browser: Browser, stage: tuple[Stage, Monitor]) -> None:
    page, faults = opened(browser, stage[1], "phone")
    manifest = page.context.new_cdp_session(page).send("Page.getAppManifest")
    assert manifest["errors"] == [] and '"display": "standalone"' in manifest["data"]
    assert not faults.told
    page.context.close()


def test_a_phone_is_turned_and_nothing_is_wider_than_it(
    browser: Browser, stage: tuple[Stage, Monitor]
) -> None:
    page, _ = opened(browser, stage[1], "phone", viewport={"width": 640, "height": 360})
    expect(page.locator("#ground")).to_contain_text("as usual", timeout=SOON_MS)
    for width, height in ((360, 640), (640, 360), (360, 640)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_function("(width) => document.documentElement.scrollWidth === width", arg=width)
        wide = page.evaluate(
            "(width) => [...document.querySelectorAll('main, main > *, .middle > *, .trace-plot, canvas')]"
            ".filter((one) => one.getBoundingClientRect().right > width + 1).map((one) => one.className)",
            width,
        )
        assert wide == []
    page.context.close()


def test_german_by_the_language_of_the_browser_and_by_the_switch(
    browser: Browser, stage: tuple[Stage, Monitor]
) -> None:
    page, faults = opened(browser, stage[1], "phone", locale="de-DE")
    rig = {"a": 1.7, "b": 1.2, "c": 2.1, "d": 3.62, "e": 0.1}  # of the machine file
    expect_run(page, "● ZEICHNET AUF", "good")
    expect(page.locator("#ground")).to_contain_text("wie üblich", timeout=SOON_MS)
    expect(page.locator("#advice")).to_contain_text("Reifen hinten", timeout=SOON_MS)
    expect(page.locator("html")).to_have_attribute("lang", "de")
    page.locator("#lengths-part summary").tap()
    expect(page.locator("#lengths text")).to_have_text([f"{name} {rig[name]:.2f} m" for name in "abcde"])
    page.locator("#language").tap()
    expect_run(page, "● RECORDING", "good")
    page.reload()
    expect_run(page, "● RECORDING", "good")  # it is kept
    page.context.close()
    assert not faults.told


def test_marks_are_off_while_the_daemon_is_gone_and_technical_events_are_folded_away(
    browser: Browser,
) -> None:
    with Stage() as stage, closing(Monitor("--connect", stage.endpoint)) as monitor:
        page, _ = opened(browser, monitor)
        expect_run(page, "RECORDING", "good")
        page.locator("#technical").click()
        stage.order(event="bus", text="its frames are stamped by the driver")
        expect(page.locator("#events")).to_contain_text("stamped", timeout=SOON_MS)
        page.locator("#technical").click()
        stage.order(event="soil_change", text="the soil holds the tyres differently")
        expect(page.locator("#events")).to_contain_text("the soil holds", timeout=SOON_MS)
        expect(page.locator("#events")).not_to_contain_text("stamped")
        expect(page.locator("#mark")).to_be_enabled()
        stage.process.kill()
        expect_run(page, "DAEMON GONE", "bad")
        expect(page.locator("#mark")).to_be_disabled()
        page.keyboard.press("m")
        expect(page.locator("#mark-dialog")).to_be_hidden()
        page.context.close()


def test_the_map_by_mouse_and_keyboard(browser: Browser, stage: tuple[Stage, Monitor]) -> None:
    page, faults = opened(browser, stage[1])
    expect(page.locator("#map-words")).to_contain_text("receivers", timeout=SOON_MS)
    follow, canvas = page.locator("#follow"), page.locator("#map")
    expect(follow).to_have_attribute("aria-pressed", "true")
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 130)
    page.mouse.up()
    expect(follow).to_have_attribute("aria-pressed", "false")
    canvas.focus()
    page.keyboard.press("f")
    expect(follow).to_have_attribute("aria-pressed", "true")
    page.keyboard.press("ArrowLeft")
    expect(follow).to_have_attribute("aria-pressed", "false")
    page.mouse.wheel(0, -400)
    for button in ("#zoom-in", "#zoom-out", "#fit", "#follow"):
        page.locator(button).click()
    expect(follow).to_have_attribute("aria-pressed", "true")
    ink = page.evaluate(COLOURS_OF_THE_MAP)
    assert ink > 20
    page.context.close()
    assert not faults.told


def test_the_demo_opens_with_the_address_of_its_page(
    browser: Browser, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    start = [sys.executable, "-c", "import sys; from tilth.cli import main; sys.exit(main())"]
    words = [*start, "demo", "--seconds", "180", "--log", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as demo:
        assert demo.stderr is not None
        found = next(filter(None, (re.search(r"http://127\.0\.0\.1:\d+/", line) for line in demo.stderr)))
        page = browser.new_page(**SIZES["desktop"])
        page.goto(found[0])
        assert "bad" not in (page.locator("#run").get_attribute("data-state") or "")
        expect(page.locator("#simulated")).to_be_visible()
        # Until its kernels are compiled a recorded drive is shown.
        expect(page.locator("#run-word")).to_have_text("● RECORDING", timeout=5 * SOON_MS)
        expect(page.locator("#map-words")).to_contain_text("4 of 4 receivers", timeout=SOON_MS)
        if request.config.getoption("--refresh"):
            expect(page.locator("#run-time")).to_have_text(re.compile("0:01:[1-5]"), timeout=2 * SOON_MS)
            page.locator("#zoom-out").click()
            picture(request, page, "page-demo")
        demo.send_signal(signal.SIGINT)
        demo.stderr.read()
        assert demo.wait(PATIENCE_S) in (0, 1)  # lost frames are this computer's business, not the page's
        expect_run(page, "NO CONNECTION", "bad")
        page.close()


def test_a_change_of_soil(
    browser: Browser, stage: tuple[Stage, Monitor], request: pytest.FixtureRequest
) -> None:
    sizes = {size: opened(browser, stage[1], size) for size in SIZES}
    pages = {size: page for size, (page, _) in sizes.items()}
    desk = pages["desktop"]
    front = desk.locator(".trace", has=desk.get_by_role("heading", name="Front tyres", exact=True))
    expect(front.locator(".trace-status")).to_have_text("estimated", timeout=SOON_MS)
    expect(desk.locator("#ground strong").first).to_have_text(re.compile("as usual"), timeout=SOON_MS)
    desk.wait_for_function("uPlot && document.querySelectorAll('.trace').length === 6")
    until(lambda: abs(_number(front) - 215) < 15)
    stage[0].order(scale=0.6)
    for page in pages.values():
        expect(page.locator("#events")).to_contain_text("soil change", timeout=SOON_MS)
    until(lambda: abs(_number(front) - 129) < 12)
    expect(desk.locator("#known")).to_contain_text("C_af: known to ±10 %", timeout=60_000)  # its sd is 5 %
    expect(desk.locator("#ground strong")).to_have_text([re.compile("soft")] * 3, timeout=SOON_MS)
    expect(desk.locator("#advice")).to_have_text(
        "Where there is room, weave the steering gently left and right, slow then quick, for 10 s, wheels to "
        "about 5°: it would tell more of the rear tyres."
    )
    for size, page in pages.items():
        narrow = page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert narrow, f"{size}: it has to be moved sideways"
        picture(request, page, f"page-{size}")
        page.context.close()
    dark, _ = opened(browser, stage[1], "tablet", color_scheme="dark")
    expect_run(dark, "RECORDING", "good")
    dark.wait_for_timeout(500)
    picture(request, dark, "page-dark")
    dark.context.close()
    stage[0].order(scale=1.0)
    assert not [fault for _, faults in sizes.values() for fault in faults.told]


def test_a_change_of_soil_that_the_tracker_finds(browser: Browser, tmp_path: Path) -> None:
    """All of it real: a tractor drives from firm soil onto soft, and the page says so while it does."""
    softer = SoilChange(at_s=60.0, C_af=0.6, C_ar=0.6, C_ai=0.6)
    scenario = Scenario(clock_offset_s=0.0, steering=DrivenManoeuvre("random"), soil=Soil(changes=(softer,)))
    with (
        closing(FieldRig(tmp_path, 400.0, scenario)) as rig,
        closing(Monitor("--connect", rig.endpoint)) as monitor,
    ):
        page, faults = opened(browser, monitor)
        rig.start()
        front = page.locator(".trace", has=page.get_by_role("heading", name="Front tyres", exact=True))
        expect(front.locator(".trace-status")).to_have_text("estimated", timeout=SOON_MS)
        before = _number(front)
        expect(page.locator("#events")).to_contain_text(
            "the soil holds the tyres differently", timeout=2 * SOON_MS
        )
        until(lambda: 0.4 * before < _number(front) < 0.8 * before)
        assert not faults.told
        page.context.close()


def _number(trace: Any) -> float:
    found = re.match(r"[\d.]+", trace.locator(".trace-value").inner_text())
    return float(found[0]) if found else 0.0


def test_what_is_hostile_is_shown_as_the_text_it_is(browser: Browser, stage: tuple[Stage, Monitor]) -> None:
    page, faults = opened(browser, stage[1])
    expect_run(page, "RECORDING", "good")
    evil = "<img src=x onerror='window.hit=1'><script>window.hit=1</script>"
    stage[0].order(event=evil, text=evil, problem=evil, version=evil)
    expect(page.locator("#events")).to_contain_text(evil, timeout=SOON_MS)
    expect(page.locator("#problems")).to_contain_text(evil, timeout=SOON_MS)
    assert page.evaluate("window.hit") is None and page.locator("main img").count() == 0
    stage[0].order(problem="", version="")
    page.context.close()
    assert not faults.told
