"""Recorded runs on the page: `tilth monitor LOG…` over real sockets, and in a real browser."""

import json
import re
from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import pytest
from chromium import SOON_MS, serious, with_browser
from client_daemon import until
from logs import MACHINE
from paths import ROOT
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from recorded_run import MARKS, SECOND, START_NS, write_run
from stage import Monitor

from tilth.cli import main
from tilth.client.link import Alive
from tilth.monitor.daemon_data import DaemonData, Heard
from tilth.monitor.json_safe import plain
from tilth.monitor.player_page import order_of
from tilth.monitor.view import View
from tilth.schemas.proto import tilth_pb2 as pb

RUN = f"{MACHINE.name}_20261121T080000Z"
SHORT = "another-rig_20261121T090000Z"

expect.set_options(timeout=SOON_MS)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    write_run(folder, 120.0, parts=2, note="clay, dry")
    write_run(folder, 30.0, name="another-rig", start_ns=START_NS + 3600 * SECOND)
    return folder


@pytest.fixture(scope="module")
def one(logs: Path) -> Iterator[Monitor]:
    with closing(Monitor(*map(str, sorted(logs.glob(f"{MACHINE.name}*.mcap"))))) as monitor:
        yield monitor


@pytest.fixture(scope="module")
def several(logs: Path) -> Iterator[Monitor]:
    with closing(Monitor(str(logs))) as monitor:
        yield monitor


def tell(monitor: Monitor, **order: Any) -> dict[str, Any]:
    _, body, _ = monitor.ask("/player", json.dumps(order).encode(), content_type="application/json")
    found: dict[str, Any] = json.loads(body)
    return found


def asked(monitor: Monitor, what: str) -> Any:
    status, body, _ = monitor.ask(f"/player/{what}")
    return json.loads(body) if status == 200 else None


def test_what_the_page_asks_for_over_its_own_server(several: Monitor) -> None:
    until(lambda: asked(several, "runs") is not None)
    rows = asked(several, "runs")
    assert [(row["name"], round(row["length_s"])) for row in rows] == [(SHORT, 30), (RUN, 120)]
    assert rows[1]["place"] == [43.5, -83.4] and rows[1]["notes"] == ["clay, dry"]
    assert [one["name"] for one in rows[1]["learned"]] == ["C_af", "C_ar", "C_ai", "sigma_f", "sigma_i"]
    assert "no run is open yet" in tell(several, order="play")["text"]
    assert tell(several, order="open", run="none") == {"done": False, "text": "none: no such run in the list"}
    assert several.ask("/player", b"{}", origin="null", content_type="application/json")[0] == 403
    assert several.ask("/player", b"{}", content_type="text/plain")[0] == 400


@pytest.mark.parametrize(
    "said",
    [{}, {"order": "stop"}, {"order": "seek", "at_s": "1"}, {"order": "seek", "at_s": float("nan")},
     {"order": "open", "run": 7}, {"order": "rate", "rate": None}],
)  # fmt: skip
def test_what_is_no_order_is_refused(said: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"an order is|are numbers"):
        order_of(said)


class Lossy:
    """What a view takes of a player whose events the network drops, or says twice."""

    followed = Alive(True, MACHINE.name)

    def __init__(self, events: list[tuple[float, pb.Event]]) -> None:
        self._rows = [pb.Place(at_s=at_s, kind="event", data=e.SerializeToString()) for at_s, e in events]
        self.heard: list[Heard] = []

    def choose(self, now_s: float) -> bool:
        return False

    def alive(self) -> tuple[bool, list[str]]:
        return True, [MACHINE.name]

    def ask_player(self, what: str, message: type[pb.Places]) -> pb.Places:
        return message(run=RUN, rows=self._rows)

    def take(self) -> list[Heard]:
        heard, self.heard = self.heard, []
        return heard


@pytest.mark.parametrize("dropped", [True, False], ids=["dropped", "heard"])
def test_each_event_that_a_player_passes_is_there_once(dropped: bool) -> None:
    events = [(at_s, pb.Event(t_ns=round(at_s * 1e9), kind="mark", text=text)) for at_s, text in MARKS]
    player = Lossy(events)
    view = View(cast(DaemonData, player), "")

    def at(at_s: float, jumps: int = 1, said: str = "") -> list[str]:
        state = pb.PlayerState(run=RUN, state="playing", rate=50.0, at_s=at_s, jumps=jumps)
        player.heard = [Heard("player", plain(state), 0.0)]
        if not dropped:
            player.heard += [Heard("event", plain(event), 0.0) for _, event in events if event.text == said]
        view.turn(0.0)
        return [event["text"] for event in json.loads(view.whole(0.0))["whole"]["events"]]

    assert at(0.0) == []
    until(lambda: at(0.5) == [] and view.has_overview)
    (first, one), (second, two) = MARKS
    assert at(first - 1) == []
    assert at(first + 1, said=one) == [one]
    assert at(second, said=two) == [one, two]
    assert at(120.0) == [one, two]
    assert at(second - 1, jumps=2) == [one]
    assert at(second + 1, jumps=2, said=two) == [one, two]


def test_a_daemon_that_runs_is_no_player(capsys: pytest.CaptureFixture[str], logs: Path) -> None:
    assert main(["monitor", "--port", "0", "--replay", str(logs)]) == 2
    assert "leave them out where you give logs" in capsys.readouterr().err


def opened(browser: Browser, monitor: Monitor, **options: Any) -> tuple[Page, list[str]]:
    settings: dict[str, Any] = {"viewport": {"width": 1440, "height": 900}} | options
    page = browser.new_context(**settings).new_page()
    faults: list[str] = []
    page.on("pageerror", lambda fault: faults.append(str(fault)))
    page.on("console", lambda line: faults.append(line.text) if line.type == "error" else None)
    page.goto(monitor.url)
    return page, faults


def at_s(page: Page) -> float:
    return float(page.locator("#play-slider").input_value())


def front(page: Page) -> float:
    trace = page.locator(".trace", has=page.get_by_role("heading", name="Front tyres", exact=True))
    found = re.match(r"[\d.]+", trace.locator(".trace-value").inner_text())
    return float(found[0]) if found else 0.0


def to_beginning(page: Page) -> None:
    if page.locator("#play").get_attribute("aria-label") == "Pause":
        page.locator("#play").click()
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")


@pytest.mark.browser
@with_browser
def test_a_run_is_played_paused_and_searched(
    browser: Browser, one: Monitor, request: pytest.FixtureRequest
) -> None:
    page, faults = opened(browser, one)
    expect(page.locator("#simulated")).to_have_text(f"replay of {RUN}")
    expect(page.locator("#run-word")).to_have_text("REPLAY")
    expect(page.locator(".marks")).to_be_hidden()
    to_beginning(page)
    page.locator("#play-rate").select_option("50")
    page.locator(".place", has_text=MARKS[0][1]).click()
    expect(page.locator("#play-time")).to_have_text("0:00:20 of 0:02:00")
    expect(page.locator("#events li", has_text=MARKS[0][1])).to_have_count(1)
    expect(page.locator("#events li", has_text=MARKS[1][1])).to_have_count(0)
    until(lambda: abs(front(page) - 215) < 11)  # firm: as recorded there
    expect(page.locator("#speed")).to_have_text("8.6 km/h")
    assert "old" not in page.locator("#soil-title").inner_text()

    page.get_by_role("button", name="Play", exact=True).click()
    expect(page.locator("#run-time")).to_have_text(re.compile("50 ×|ended"))
    expect(page.locator("#run-time")).to_have_text("ended")
    until(lambda: abs(front(page) - 129) < 8)  # soft, in the second half
    assert at_s(page) == 120.0
    expect(page.locator("#events li", has_text=MARKS[1][1])).to_have_count(1)

    turn = page.locator(".place", has_text="turn").first
    turn.click()
    expect(page.locator("#play-time")).to_have_text(re.compile("0:00:3[78] of"))
    expect(turn).to_have_attribute("aria-current", "true")
    expect(page.locator("#map-words")).to_contain_text("wheels")
    until(lambda: abs(front(page) - 215) < 11)
    track = "[...document.querySelectorAll('canvas')].length"
    assert page.evaluate(track) >= 8  # map, steering, six parameters
    page.locator(".place", has_text=MARKS[1][1]).click()
    expect(page.locator("#play-time")).to_have_text("0:01:15 of 0:02:00")
    expect(page.locator("#ground strong").first).to_have_text(re.compile("soft"))
    if request.config.getoption("--refresh"):
        page.locator("#runs-part summary").click()
        expect(page.locator("#runs tr")).to_have_count(1)
        shot = Image.open(BytesIO(page.screenshot(full_page=True)))
        shot.quantize(200, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
            ROOT / "docs/pictures/page-replay.png", optimize=True
        )
    page.context.close()
    assert not faults


@pytest.mark.browser
@with_browser
def test_all_of_it_by_keyboard(browser: Browser, one: Monitor) -> None:
    page, faults = opened(browser, one)
    expect(page.locator("#player")).to_be_visible()
    to_beginning(page)
    slider = page.locator("#play-slider")
    slider.focus()
    page.keyboard.press("Home")
    expect(page.locator("#play-time")).to_have_text("0:00:00 of 0:02:00")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    expect(slider).to_have_attribute("aria-valuetext", "0:00:03 of 0:02:00")
    page.keyboard.press("End")
    expect(page.locator("#play-time")).to_have_text("0:02:00 of 0:02:00")
    page.locator(".place", has_text=MARKS[1][1]).focus()
    page.keyboard.press("Enter")
    expect(page.locator("#play-time")).to_have_text("0:01:15 of 0:02:00")
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press(" ")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Pause")
    page.keyboard.press(" ")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")
    page.keyboard.press("m")
    expect(page.locator("#mark-dialog")).to_be_hidden()
    page.context.close()
    assert not faults


@pytest.mark.browser
@with_browser
def test_runs_are_listed_and_a_click_plays_one(browser: Browser, several: Monitor) -> None:
    page, faults = opened(browser, several)
    row = page.locator("#runs tr", has_text=RUN)
    expect(row).to_contain_text("0:02:00")
    expect(row).to_contain_text("43.5000°, -83.4000°")
    expect(row).to_contain_text(re.compile(r"C_af 1[23]\d kN/rad"))
    expect(row).to_contain_text("clay, dry")
    expect(page.locator("#runs tr")).to_have_count(2)
    page.get_by_role("button", name=f"Play {RUN}").click()
    expect(page.locator("#simulated")).to_have_text(f"replay of {RUN}")
    expect(page.locator("#machine")).to_have_text(MACHINE.name)
    expect(page.locator("#map-words")).to_contain_text("4 of 4 receivers")
    page.locator("#runs-part summary").click()
    page.get_by_role("button", name=f"Play {SHORT}").click()
    expect(page.locator("#simulated")).to_have_text(f"replay of {SHORT}")
    expect(page.locator("#machine")).to_have_text("another-rig")
    expect(page.locator("#play-time")).to_have_text(re.compile("of 0:00:30"))
    page.context.close()
    assert not faults


@pytest.mark.browser
@with_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 390])
def test_a_checker_of_accessibility_finds_nothing_serious(
    browser: Browser, one: Monitor, scheme: str, width: int
) -> None:
    page, _ = opened(browser, one, color_scheme=scheme, viewport={"width": width, "height": 900})
    expect(page.locator(".place").first).to_be_visible()
    page.locator("#runs-part summary").click()
    expect(page.locator("#runs tr")).to_have_count(1)
    assert serious(page) == []
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.context.close()
