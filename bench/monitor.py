"""What does the live page cost, and does it stay as it is over a long day?

    python bench/monitor.py [--quick]

(a) CPU time of the page's server and of each of two browsers, at ten poses a second and an estimate and a
    status each second, as shares of one core; and that of the server alone with nobody looking
(b) eight hours of messages through the page's own view and into a real browser, as fast as it takes them:
    size of a whole message, heap of the browser and time of one drawing, after one hour and after eight

A browser draws without a graphics card here: its own share is what a tablet would beat.
"""

import argparse
import asyncio
import os
import sys
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from playwright.async_api import CDPSession, Page, async_playwright
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

import uvicorn
from stage import Monitor, Stage, drive, estimate, pose, status

from tilth.monitor.addresses import listening_socket
from tilth.monitor.daemon_data import Heard
from tilth.monitor.json_safe import plain
from tilth.monitor.server import FILES
from tilth.monitor.view import View, installed_version
from tilth.schemas.channels import CHANNEL
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.packaged import packaged_file

CHROMIUM = os.environ.get("TILTH_CHROMIUM", "/usr/bin/chromium-headless-shell")
HOUR_S = 3600
POSES_PER_S = 1  # in (b): more of them leave no more behind


def cpu_s(pid: int) -> float:
    """Of a process with all its threads."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


async def metrics(devtools: CDPSession) -> dict[str, float]:
    rows = (await devtools.send("Performance.getMetrics"))["metrics"]
    return {row["name"]: row["value"] for row in rows}


async def cost(seconds: float) -> None:
    with Stage() as stage:
        monitor = Monitor("--connect", stage.endpoint)
        async with async_playwright() as playwright:
            browser = await playwright.chromium.launch(executable_path=CHROMIUM)
            await asyncio.sleep(3.0)
            alone = cpu_s(monitor.process.pid)
            await asyncio.sleep(seconds)
            alone = (cpu_s(monitor.process.pid) - alone) / seconds
            viewers = []
            for _ in range(2):
                page = await browser.new_page(viewport={"width": 1280, "height": 800})
                await page.goto(monitor.url)
                devtools = await page.context.new_cdp_session(page)
                await devtools.send("Performance.enable", {"timeDomain": "threadTicks"})  # CPU, not wall
                viewers.append(devtools)
            await asyncio.sleep(3.0)
            before = [cpu_s(monitor.process.pid), *[(await metrics(one))["TaskDuration"] for one in viewers]]
            began = time.monotonic()
            await asyncio.sleep(seconds)
            took = time.monotonic() - began
            after = [cpu_s(monitor.process.pid), *[(await metrics(one))["TaskDuration"] for one in viewers]]
            shares = [(b - a) / took for a, b in zip(before, after, strict=True)]
            await browser.close()
        monitor.close()
    print(f"(a) server with nobody looking {alone:.1%} of a core, with two viewers {shares[0]:.1%};")
    print(
        f"    main thread of each browser {shares[1]:.1%} and {shares[2]:.1%} (wall time, on a shared core)"
    )


class Rehearsed:
    """In place of what is heard: a long drive, as the page's view would take it turn by turn."""

    followed, base = ("jd7930-parker500", True), ""

    def __init__(self, text: str) -> None:
        self._rig = CHANNEL["/rig"].encode(parse_machine(text))
        self._points = drive(1 / POSES_PER_S)
        self._turn = 0

    def alive(self) -> tuple[bool, list[str]]:
        return True, ["jd7930-parker500"]

    def refused(self) -> dict[str, int]:
        return {}

    def choose(self, now_s: float) -> bool:
        return False

    def take(self) -> list[Heard]:
        t_s = self._turn / POSES_PER_S
        t_ns = 1_790_000_000_000_000_000 + int(1e9 * t_s)
        told = {"pose": CHANNEL["/pose"].encode(pose(t_ns, next(self._points), ""))}
        if self._turn % POSES_PER_S == 0:
            told["soil_tire"] = CHANNEL["/soil_tire"].encode(estimate(t_ns, t_s, 1.0, t_s))
            orders = {"version": installed_version(), "recording": True, "lost": "", "problem": ""}
            told["status"] = status(t_ns, t_s, orders).SerializeToString()
        if self._turn == 0:
            told["rig"] = self._rig
        self._turn += 1
        kinds: dict[str, Any] = {
            "pose": pb.Pose,
            "soil_tire": pb.SoilTireEstimate,
            "status": pb.Status,
            "rig": pb.Rig,
        }
        return [Heard(kind, plain(kinds[kind].FromString(data)), t_s) for kind, data in told.items()]


def messages(view: View, hours: float) -> Iterator[str]:
    for turn in range(round(hours * HOUR_S * POSES_PER_S)):
        now_s = turn / POSES_PER_S
        told = view.turn(now_s)
        yield view.whole(now_s) if told.anew else told.text


async def drawing_ms(page: Page) -> float:
    """Time of the page's main thread for all six plots and the map, drawn anew."""
    return float(
        await page.evaluate(
            """async () => {
                const frame = () => new Promise((done) => requestAnimationFrame(done));
                await frame();
                const began = performance.now();
                for (let i = 0; i < 20; i++) {
                    document.querySelector('[data-seconds="0"]').click();
                    document.querySelector("#zoom-in").click();
                    await frame();
                    await frame();
                }
                return (performance.now() - began) / 40;
            }"""
        )
    )


async def long_day(hours: tuple[float, ...]) -> None:
    view = View(Rehearsed(packaged_file().text), "")  # type: ignore[arg-type]
    told: asyncio.Queue[str] = asyncio.Queue(100)

    async def live(socket: WebSocket) -> None:
        await socket.accept()
        await socket.send_text(view.whole(0.0))
        while True:
            await socket.send_text(await told.get())
            told.task_done()

    routes: list[Any] = [WebSocketRoute("/live", live), *_files()]
    listener = listening_socket("127.0.0.1", 0)
    server = uvicorn.Server(
        uvicorn.Config(Starlette(routes=routes), log_level="error", ws="websockets-sansio")
    )
    serving = asyncio.create_task(server.serve([listener]))
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=CHROMIUM)
        page = await browser.new_page(viewport={"width": 1280, "height": 800})
        await page.goto(f"http://127.0.0.1:{listener.getsockname()[1]}/")
        devtools = await page.context.new_cdp_session(page)
        await devtools.send("Performance.enable")
        await devtools.send("HeapProfiler.enable")
        stream, fed, began = messages(view, max(hours)), 0, time.monotonic()
        for mark in hours:
            for message in stream:
                await told.put(message)
                fed += 1
                if fed >= round(mark * HOUR_S * POSES_PER_S):
                    break
            await told.join()
            await page.wait_for_timeout(1000)
            await devtools.send("HeapProfiler.collectGarbage")
            heap = (await metrics(devtools))["JSHeapUsedSize"] / 1e6
            whole = len(view.whole(0.0)) / 1e6
            rows = await page.evaluate("document.querySelectorAll('*').length")
            drawn, took = await drawing_ms(page), time.monotonic() - began
            print(
                f"(b) after {mark:g} h: heap {heap:.1f} MB, {rows} elements, a drawing {drawn:.1f} ms, "
                f"whole message {whole:.2f} MB; {fed} messages in {took:.0f} s",
                flush=True,
            )
        await browser.close()
    server.should_exit = True
    await serving


def _files() -> list[Route]:
    folder = resources.files("tilth.monitor") / "page"

    def route(path: str, name: str, kind: str) -> Route:
        async def answer(request: Request) -> Response:
            return Response((folder / name).read_bytes(), media_type=kind)

        return Route(path, answer)

    return [route(*row) for row in FILES]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of it")
    quick = parser.parse_args().quick
    asyncio.run(cost(6.0 if quick else 30.0))
    asyncio.run(long_day((0.1, 0.8) if quick else (1.0, 8.0)))


if __name__ == "__main__":
    main()
