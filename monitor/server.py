"""Serves the page: one HTML, its own scripts and styles, a stream of JSON, the mark, and the recorded runs of
a player. All else is 404.

Read only but for the mark and the orders to a player. What a daemon says is data to the browser, never
markup: the policy in every answer's header lets no script run but the page's own.
"""

import asyncio
import contextlib
import json
import logging
import signal
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib import resources
from typing import Any, Final, NamedTuple, Protocol, TypeVar

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from tilth.client.received import Refused
from tilth.monitor.daemon_data import DaemonData, MarkAnswer
from tilth.monitor.entry_code import EntryCode
from tilth.monitor.guard import Guard
from tilth.monitor.invitation import Invitation
from tilth.monitor.player_page import order_of, places_of, runs_of
from tilth.monitor.setup_page import SETUP, FirstMachine, answers_of, entrance, heard
from tilth.monitor.view import Turn
from tilth.schemas.limiter import Limiter, of_address

TURN_S: Final = 0.1
IDLE_S: Final = 1.0  # where nothing is new: ages grow
WAITING: Final = 50  # messages for a browser that does not take them: five seconds, then it has to come anew
VIEWERS: Final = 16  # pages of other computers, and as many of this one
ASKED: Final = 16  # requests that wait for a daemon, of other computers; they have threads of their own
EACH: Final = 8  # of either, of one computer
MARK_BYTES: Final = 1024  # as the daemon allows
_PAGE: Final = resources.files("tilth.monitor") / "page"
REPORT_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
"""Of a report, which a daemon sends: its own styles and pictures, in an origin of its own, and no script."""
FILES: Final = (  # path, file below monitor/page, type
    ("/", "index.html", "text/html"),
    ("/page.css", "page.css", "text/css"),
    ("/main.js", "main.js", "text/javascript"),
    ("/language.js", "language.js", "text/javascript"),
    ("/german.js", "german.js", "text/javascript"),
    ("/marks.js", "marks.js", "text/javascript"),
    ("/implement.js", "implement.js", "text/javascript"),
    ("/moved.js", "moved.js", "text/javascript"),
    ("/words.js", "words.js", "text/javascript"),
    ("/tiles.js", "tiles.js", "text/javascript"),
    ("/driver.js", "driver.js", "text/javascript"),
    ("/experiment.js", "experiment.js", "text/javascript"),
    ("/calibration.js", "calibration.js", "text/javascript"),
    ("/map.js", "map.js", "text/javascript"),
    ("/lengths.js", "lengths.js", "text/javascript"),
    ("/over.js", "over.js", "text/javascript"),
    ("/player.js", "player.js", "text/javascript"),
    ("/report.js", "report.js", "text/javascript"),
    ("/runs.js", "runs.js", "text/javascript"),
    ("/steering.js", "steering.js", "text/javascript"),
    ("/traces.js", "traces.js", "text/javascript"),
    ("/icon.svg", "icon.svg", "image/svg+xml"),
    ("/page.webmanifest", "page.webmanifest", "application/manifest+json"),
    ("/worker.js", "worker.js", "text/javascript"),
    ("/uplot/uPlot.iife.min.js", "uplot/uPlot.iife.min.js", "text/javascript"),
    ("/uplot/uPlot.min.css", "uplot/uPlot.min.css", "text/css"),
    ("/uplot/LICENSE", "uplot/LICENSE", "text/plain"),
)
SETUP_FILES: Final = (
    (SETUP, "setup.html", "text/html"),
    ("/setup.css", "setup.css", "text/css"),
    ("/setup.js", "setup.js", "text/javascript"),
)


class Shown(Protocol):
    """What the page shows: a View, or something before it."""

    def whole(self, now_s: float) -> str: ...

    def turn(self, now_s: float) -> Turn: ...


Said = str | tuple[int, str]
"""What a browser is sent: a message, or at last a code and why the stream ends."""
TOO_SLOW: Final = (1013, "too slow")
GIVEN_WAY: Final = (4001, "another page has taken this one's place")
Answer = Callable[[Request], Awaitable[Response]]
T = TypeVar("T")


class Viewers:
    """The browsers that are there, each with what it has not yet taken.

    Where no place is left, the oldest page of who has most of them makes room: nobody is locked out by pages
    that are open somewhere and looked at by no one.
    """

    def __init__(self, view: Shown) -> None:
        self._view = view
        self._queues: dict[asyncio.Queue[Said], str] = {}  # and whose it is, the oldest first
        self._limiter = Limiter(VIEWERS, EACH, "pages")

    async def run(self) -> None:
        """Turn by turn, until cancelled."""
        sent_s = 0.0
        while True:
            now_s = time.monotonic()
            turn = self._view.turn(now_s)
            if turn.news or turn.anew or now_s - sent_s >= IDLE_S:
                sent_s = now_s
                self._say(self._view.whole(now_s) if turn.anew else turn.text)
            await asyncio.sleep(TURN_S)

    def _say(self, text: str) -> None:
        for queue in list(self._queues):
            try:
                queue.put_nowait(text)
            except asyncio.QueueFull:
                self._end(queue, TOO_SLOW)

    def _end(self, queue: "asyncio.Queue[Said]", why: tuple[int, str]) -> None:
        """The page's stream ends after what it is just sent."""
        self._limiter.leave(self._queues.pop(queue))
        while not queue.empty():
            queue.get_nowait()
        queue.put_nowait(why)

    def _enter(self, client: str) -> str:
        """Why there is no place for a page of that client; "" where there is one now."""
        full = self._limiter.enter(client)
        while full and (owner := self._limiter.in_the_way(client)) is not None:
            self._end(next(queue for queue, whose in self._queues.items() if whose == owner), GIVEN_WAY)
            full = self._limiter.enter(client)
        return full

    async def serve(self, socket: WebSocket) -> None:
        """One browser, until it goes or is too slow."""
        client = _client_of(socket)
        if full := self._enter(client):
            await socket.send_denial_response(PlainTextResponse(f"{full}\n", 503))
            return
        queue: asyncio.Queue[Said] = asyncio.Queue(WAITING)
        queue.put_nowait(self._view.whole(time.monotonic()))
        self._queues[queue] = client
        sending: asyncio.Task[None] | None = None
        try:
            await socket.accept()
            sending = asyncio.create_task(_send(socket, queue))
            while (await socket.receive())["type"] != "websocket.disconnect":
                pass  # a page has nothing to say here
        finally:
            if queue in self._queues:
                self._limiter.leave(self._queues.pop(queue))
            if sending is not None:
                sending.cancel()
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                    await sending


async def _send(socket: WebSocket, queue: "asyncio.Queue[Said]") -> None:
    while isinstance(said := await queue.get(), str):
        await socket.send_text(said)
    await socket.close(*said)


def _client_of(connection: HTTPConnection) -> str:
    return of_address(connection.client.host if connection.client else "")


class Inside(NamedTuple):
    """What is behind a code: making a machine file, and all else."""

    first: FirstMachine
    entry: EntryCode


def application(
    daemon_data: DaemonData, view: Shown, invitation: Invitation | None = None, inside: Inside | None = None
) -> ASGIApp:
    """The page, its live stream, the query for marks and the orders, for any ASGI server."""
    viewers = Viewers(view)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        turning = asyncio.create_task(viewers.run())
        yield
        turning.cancel()

    asked = PageQuery()
    files = [_file(path, (_PAGE / name).read_bytes(), kind) for path, name, kind in FILES]
    live = WebSocketRoute("/live", viewers.serve)
    routes = [*files, *_orders(daemon_data, asked), *_asked(daemon_data, asked), live]
    if inside is None:
        return Guard(Starlette(routes=routes, lifespan=lifespan), invitation)
    routes = [*_setup(inside, asked), *routes]
    return Guard(Starlette(routes=routes, lifespan=lifespan), None, inside.entry)


def _setup(inside: Inside, asked: "PageQuery") -> list[Route]:
    """The pages for who has the code; the first of all while there is no machine file."""
    first = inside.first

    def listen(_: None) -> str:
        first.listen()
        return ""

    async def opening(request: Request) -> Response:
        if first.is_first:
            return RedirectResponse(SETUP, 303)
        return Response((_PAGE / "index.html").read_bytes(), media_type="text/html")

    told = {f"{SETUP}/check": first.check, f"{SETUP}/save": first.save}
    return [
        Route("/", opening),
        entrance(inside.entry),
        heard(first),
        *(_file(path, (_PAGE / name).read_bytes(), kind) for path, name, kind in SETUP_FILES),
        *(Route(path, asked.fairly(_answers(ask)), methods=["POST"]) for path, ask in told.items()),
        Route(f"{SETUP}/listen", asked.fairly(_ordered(lambda sent: None, listen)), methods=["POST"]),
    ]


def _answers(ask: Callable[[dict[str, str]], dict[str, Any]]) -> Answer:
    async def answer(request: Request) -> Response:
        try:
            answers = answers_of(await _json(request, "an answer"))
        except ValueError as error:
            return JSONResponse({"wrong": [["", str(error)]]}, 400)
        return JSONResponse(await run_in_threadpool(ask, answers))

    return answer


class PageQuery:
    """Requests that wait for a daemon, each in a thread. Files wait for nothing, and are not among them."""

    def __init__(self) -> None:
        self._limiter = Limiter(ASKED, EACH, "requests")

    def fairly(self, answer: Answer) -> Answer:
        """The same, for as many at a time as there are places."""

        async def limited(request: Request) -> Response:
            client = _client_of(request)
            if full := self._limiter.enter(client):
                return JSONResponse({"noted": False, "done": False, "text": full}, 429)
            try:
                return await answer(request)
            finally:
                self._limiter.leave(client)

        return limited


def _orders(daemon_data: DaemonData, asked: PageQuery) -> list[Route]:
    """What a page sends: marks, and orders to whoever runs beside the daemon."""
    answers = {
        "/mark": _noted(daemon_data.mark),
        "/accept": _noted(daemon_data.accept),
        "/implement": _noted(daemon_data.implement),
        "/load": _noted(daemon_data.load),
        "/player": _ordered(order_of, daemon_data.order),
        "/experiment": _ordered(_kind, daemon_data.experiment),
        "/calibration": _ordered(_kind, daemon_data.calibration),
        "/report": _ordered(lambda sent: None, lambda _: daemon_data.make_report(), "a request for a report"),
    }
    return [Route(path, asked.fairly(answer), methods=["POST"]) for path, answer in answers.items()]


def _asked(daemon_data: DaemonData, asked: PageQuery) -> list[Route]:
    """What a page asks for, beside its own files."""

    async def report_file(request: Request) -> Response:
        try:
            data = await run_in_threadpool(daemon_data.report_file)
        except Refused as refused:
            return PlainTextResponse(f"{refused}\n", 503)
        return Response(data, media_type="text/html", headers={"content-security-policy": REPORT_POLICY})

    told = [
        Route(f"/player/{name}", asked.fairly(_told(daemon_data, ask)))
        for name, ask in (("runs", runs_of), ("places", places_of))
    ]
    return [Route("/report.html", asked.fairly(report_file)), *told]


def _noted(ask: Callable[[str], MarkAnswer]) -> Answer:
    async def answer(request: Request) -> Response:
        try:
            text = await _mark_text(request)
        except ValueError as error:
            return _answer(MarkAnswer(False, str(error)), 400)
        return _answer(await run_in_threadpool(ask, text), 200)

    return answer


def _ordered(
    wanted: Callable[[dict[str, object]], T], ask: Callable[[T], str], what: str = "an order"
) -> Answer:
    """wanted: makes the order of what was sent, or raises ValueError. ask: gives why it is refused, or ""."""

    async def answer(request: Request) -> Response:
        try:
            order = wanted(await _json(request, what))
        except ValueError as error:
            return JSONResponse({"done": False, "text": str(error)}, 400)
        refused = await run_in_threadpool(ask, order)
        return JSONResponse({"done": not refused, "text": refused})

    return answer


def _kind(sent: dict[str, object]) -> str:
    """Raises ValueError."""
    kind = sent.get("kind", "")
    if not isinstance(kind, str):
        raise ValueError("the kind of an order is a word")
    return kind


def _file(path: str, data: bytes, kind: str) -> Route:
    async def answer(request: Request) -> Response:
        return Response(data, media_type=kind)

    return Route(path, answer)


def _answer(mark: MarkAnswer, status: int) -> Response:
    return JSONResponse({"noted": mark.noted, "text": mark.text}, status)


def _told(daemon_data: DaemonData, ask: Callable[[DaemonData], Any]) -> Answer:
    async def answer(request: Request) -> Response:
        try:
            return JSONResponse(await run_in_threadpool(ask, daemon_data))
        except Refused as refused:
            return PlainTextResponse(f"{refused}\n", 503)

    return answer


async def _json(request: Request, what: str) -> dict[str, object]:
    """The object that was sent. Raises ValueError."""
    if request.headers.get("content-type") != "application/json":  # what a form of another page cannot send
        raise ValueError(f"{what} is sent as JSON")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > 8 * MARK_BYTES:  # as JSON writes its worst characters, and some
            raise ValueError(f"{what} of so many bytes is too long; {MARK_BYTES} bytes are the most")
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise ValueError(f"{what} is sent as JSON with its text")
    if not _is_unicode(found):
        raise ValueError(f"a text in it is no Unicode: {what} with half a character cannot be sent on")
    return found


def _is_unicode(found: dict[str, object]) -> bool:
    """Whether its texts can be sent: JSON can say halves of characters."""
    try:
        json.dumps(found, ensure_ascii=False).encode()
    except (UnicodeEncodeError, RecursionError):
        return False
    return True


async def _mark_text(request: Request) -> str:
    """The text of a mark. Raises ValueError."""
    found = await _json(request, "a mark")
    if "text" not in found:
        raise ValueError("a mark is sent as JSON with its text")
    text = found["text"]
    if not isinstance(text, str) or not text.strip():
        raise ValueError("write something first")
    size = len(text.encode(errors="replace"))
    if size > MARK_BYTES:
        raise ValueError(f"this mark has {size} bytes; {MARK_BYTES} are the most")
    return " ".join(text.split())


def _is_fault(record: logging.LogRecord) -> bool:
    """A stream that is refused with an answer of its own is none, as this server believes."""
    return "completing handshake" not in record.getMessage()


def serve(
    daemon_data: DaemonData,
    view: Shown,
    listener: socket.socket,
    invitation: Invitation | None = None,
    inside: Inside | None = None,
) -> None:
    """Until SIGINT or SIGTERM: both are how it is meant to end."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logging.getLogger("uvicorn.error").addFilter(_is_fault)
    config = uvicorn.Config(
        application(daemon_data, view, invitation, inside),
        ws="websockets-sansio",
        ws_max_size=4096,
        ws_per_message_deflate=False,  # the way is short: no core is spent on packing
        log_level="error",
        server_header=False,
        access_log=False,
        timeout_graceful_shutdown=1,
    )
    with contextlib.suppress(KeyboardInterrupt):  # uvicorn ends in order, then hands the signal on
        uvicorn.Server(config).run([listener])
