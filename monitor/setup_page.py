"""The pages on which somebody with the code makes this computer's machine file, and the door before them."""

from importlib import resources
from typing import Any, Final, Protocol
from urllib.parse import parse_qs

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from tilth.monitor.entry_code import ENTERED, REMEMBERED_S, EntryCode, TooSoon
from tilth.schemas.limiter import of_address

ENTER: Final = "/enter"
SETUP: Final = "/setup"
ENTRY_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; "
    "base-uri 'none'; frame-ancestors 'none'"
)
"""Of the page that asks for the code, which is all that a stranger sees: it has no script."""
CODE_BYTES: Final = 256
TOLD: Final = {
    "": "",
    "wrong": "This is not the code. · Das ist nicht der Code.",
    "soon": "One try a second: once more, please. · Ein Versuch je Sekunde: bitte noch einmal.",
}
_PAGE: Final = resources.files("tilth.monitor") / "page"


class FirstMachine(Protocol):
    """Who listens, drafts, checks and keeps; each gives what the page shows."""

    @property
    def is_first(self) -> bool:
        """Whether there is no machine file yet."""
        ...

    def heard(self) -> dict[str, Any]: ...

    def listen(self) -> None:
        """Anew."""

    def check(self, answers: dict[str, str]) -> dict[str, Any]: ...

    def save(self, answers: dict[str, str]) -> dict[str, Any]: ...


def entry_page(why: str = "", status: int = 401) -> Response:
    """Asks for the code. why: of TOLD."""
    text = (_PAGE / "enter.html").read_text(encoding="utf-8").replace("{told}", TOLD[why])
    headers = {"content-security-policy": ENTRY_POLICY, "referrer-policy": "same-origin"}
    return Response(text, status, headers, "text/html")  # without a referrer the form would have no origin


def entrance(entry: EntryCode) -> Route:
    """Takes the code."""

    async def enter(request: Request) -> Response:
        body = b""
        try:
            async for part in request.stream():
                body += part
                if len(body) > CODE_BYTES:
                    return entry_page("wrong")
        except ClientDisconnect:
            return entry_page("wrong")
        code = parse_qs(body.decode("latin-1")).get("code", [""])[0]
        client = of_address(request.client.host if request.client else "")
        try:
            cookie = entry.take(client, code)
        except TooSoon:
            return entry_page("soon", 429)
        if not cookie:
            return entry_page("wrong")
        answer = RedirectResponse("/", 303)
        answer.set_cookie(ENTERED, cookie, REMEMBERED_S, httponly=True, samesite="strict")
        return answer

    return Route(ENTER, enter, methods=["POST"])


def heard(first: FirstMachine) -> Route:
    """What is heard on the buses by now."""

    async def answer(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(first.heard))

    return Route(f"{SETUP}/heard", answer)


def answers_of(sent: dict[str, object]) -> dict[str, str]:
    """Field -> what was written there. Raises ValueError."""
    if not all(isinstance(value, str) for value in sent.values()):
        raise ValueError("each answer is a text")
    return {name: str(value) for name, value in sent.items()}
