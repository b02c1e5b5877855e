"""Who may see the page from another computer."""

import asyncio
from typing import Any

import pytest
from starlette.responses import PlainTextResponse

from tilth.monitor.invitation import ASK, COOKIE, KEY, Invitation
from tilth.monitor.server import Guard


def answer(guard: Guard, client: str, path: str = "/", query: str = "", cookie: str = "") -> tuple[int, Any]:
    """Status and headers."""
    told: list[Any] = []

    async def send(message: Any) -> None:
        told.append(message)

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    headers = [(b"host", b"192.168.1.5:8117"), *([(b"cookie", cookie.encode())] if cookie else [])]
    scope = {
        "type": "http", "method": "GET", "path": path, "query_string": query.encode(), "headers": headers,
        "client": (client, 5000), "server": ("192.168.1.5", 8117), "scheme": "http", "root_path": "",
    }  # fmt: skip
    asyncio.run(guard(scope, receive, send))
    return told[0]["status"], dict(told[0]["headers"])


def test_a_word_lets_in_one_phone_once() -> None:
    words: list[str] = []
    guard = Guard(PlainTextResponse("the page"), Invitation(words.append))
    phone, other = "192.168.1.77", "192.168.1.78"
    assert answer(guard, "127.0.0.1")[0] == answer(guard, "::1")[0] == answer(guard, "192.168.1.5")[0] == 200
    for path in ("/", "/live", "/main.js", "/mark"):
        assert answer(guard, phone, path)[0] == 403
        assert answer(guard, phone, path, cookie=f"{COOKIE}=x")[0] == 403
    assert answer(guard, phone, "/live", f"{KEY}={words[0]}")[0] == 403  # it opens the page, nothing else
    status, headers = answer(guard, phone, query=f"{KEY}={words[0]}")
    assert (status, headers[b"location"]) == (303, b"/")
    assert b"HttpOnly" in headers[b"set-cookie"]
    guest = headers[b"set-cookie"].decode().partition(";")[0]
    assert answer(guard, phone, "/live", cookie=guest)[0] == 200
    assert answer(guard, other, query=f"{KEY}={words[0]}")[0] == 403
    assert len(words) == 2 and answer(guard, other, query=f"{KEY}={words[1]}")[0] == 303
    assert "QR code" in ASK


@pytest.mark.parametrize("word", ["", "ü", "x" * 10_000])
def test_a_wrong_word_lets_in_nobody(word: str) -> None:
    invitation = Invitation(lambda told: None)
    assert invitation.take(word) == "" and not invitation.knows(word)
