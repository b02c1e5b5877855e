"""Stands before the page's server: which requests are answered, and with which headers."""

from typing import Final

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from tilth.monitor.addresses import is_loopback
from tilth.monitor.entry_code import ENTERED, EntryCode
from tilth.monitor.invitation import ASK, COOKIE, KEY, Invitation
from tilth.monitor.origin import Refusal, refusal
from tilth.monitor.setup_page import ENTER, SETUP, entry_page

POLICY: Final = (
    "default-src 'none'; manifest-src 'self'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS: Final = (
    ("content-security-policy", POLICY),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cache-control", "no-cache"),
)


class Guard:
    """Adds the headers to every answer; hears no page of another origin, no computer that is not invited."""

    def __init__(
        self, app: ASGIApp, invitation: Invitation | None = None, entry: EntryCode | None = None
    ) -> None:
        """invitation: None where all that reach this computer may look. entry: where nobody may who has not
        brought the code."""
        self._app, self._invitation, self._entry = app, invitation, entry

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def headed(message: Message) -> None:
            if message["type"] == "http.response.start":
                own = {name for name, _ in message["headers"]}
                message["headers"] += [
                    (name.encode(), value.encode()) for name, value in HEADERS if name.encode() not in own
                ]
            await send(message)

        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        refused = refusal(connection.headers.getlist("host"), connection.headers.getlist("origin"))
        if refused is not None:
            answer: Response | None = _denied(refused)
        else:
            answer = self._of_stranger(connection) or self._of_uninvited(connection)
        if answer is None:
            await self._app(scope, receive, headed)
        elif scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(answer)
        else:
            await answer(scope, receive, headed)

    def _of_stranger(self, connection: HTTPConnection) -> Response | None:
        """What is answered to who has not brought the code; None for all others, and where it is brought."""
        path = connection.url.path
        if self._entry is None or self._entry.knows(connection.cookies.get(ENTERED, "")):
            return None
        if connection.scope["type"] == "http" and path in ("/", SETUP):
            return entry_page()
        return None if path == ENTER else _denied(Refusal(403, "enter the code first"))

    def _of_uninvited(self, connection: HTTPConnection) -> Response | None:
        """What another computer is answered that is not let in, or only now; None for all others."""
        invitation, client, here = self._invitation, connection.client, connection.scope.get("server")
        if invitation is None or client is None or is_loopback(client.host.removeprefix("::ffff:")):
            return None
        if here is not None and client.host == here[0]:  # this computer, by its address in a network
            return None
        if invitation.knows(connection.cookies.get(COOKIE, "")):
            return None
        guest = connection.url.path == "/" and invitation.take(connection.query_params.get(KEY, ""))
        if not guest:
            return _denied(Refusal(403, ASK))
        answer = RedirectResponse("/", 303)
        answer.set_cookie(COOKIE, guest, httponly=True, samesite="lax")
        return answer


def _denied(refused: Refusal) -> Response:
    return PlainTextResponse(f"{refused.why}\n", refused.status)
