"""`tilth setup` over its own sockets: closed before the code, and what it says with it. In a browser:
tests/monitor/test_setup_page.py."""

import http.client
import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import pytest
from setting_up import CODE, SettingUp
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tilth.cli import main
from tilth.monitor.entry_code import ENTERED
from tilth.monitor.server import FILES, SETUP_FILES

JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SettingUp]:
    with closing(SettingUp(tmp_path_factory.mktemp("setup"))) as one:
        yield one


def ask(
    page: SettingUp, path: str, body: str | None = None, method: str = "", **headers: str
) -> tuple[int, str, Any]:
    connection = http.client.HTTPConnection(urlsplit(page.url).netloc, timeout=60)
    with closing(connection):
        connection.request(method or ("GET" if body is None else "POST"), path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode(), answer.headers


@pytest.fixture(scope="module")
def cookie(page: SettingUp) -> str:
    status, _, headers = ask(page, "/enter", urlencode({"code": CODE}))
    while status == 429:  # another test has just tried
        status, _, headers = ask(page, "/enter", urlencode({"code": CODE}))
    assert (status, headers["location"]) == (303, "/")
    assert {"HttpOnly", "SameSite=strict"} <= set(headers["set-cookie"].split("; "))
    return str(headers["set-cookie"].partition(";")[0])


EVERYTHING = sorted(
    {path for path, _, _ in (*FILES, *SETUP_FILES)} | {"/setup/heard", "/report.html", "/nothing"}
)
ORDERS = (
    "/setup/check",
    "/setup/save",
    "/setup/listen",
    "/mark",
    "/accept",
    "/implement",
    "/player",
    "/report",
)


@pytest.mark.parametrize("cookies", ["", f"{ENTERED}=", f"{ENTERED}=x.y", "tilth_guest=x"])
def test_nothing_is_open_before_the_code(page: SettingUp, cookies: str) -> None:
    """Also not from this computer itself; the page that asks for it has no script."""
    for path in EVERYTHING:
        status, text, headers = ask(page, path, cookie=cookies)
        if path in ("/", "/setup"):
            assert status == 401 and 'name="code"' in text and "<script" not in text
            assert "default-src 'none'" in headers["content-security-policy"]
        else:
            assert status == 403 and text == "enter the code first\n", path
    for path in ORDERS:
        assert ask(page, path, "{}", cookie=cookies, **JSON)[0] == 403, path
    for method in ("HEAD", "OPTIONS", "PUT"):
        assert ask(page, "/setup/save", None, method, cookie=cookies)[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        connect(page.url.replace("http", "ws") + "live", additional_headers={"cookie": cookies})
    assert not page.file.exists()


@pytest.mark.parametrize(
    "body", ["", "code=", "code=wrong", "code=" + "A" * 5000, "\0", "code=%ff%00&code=ABCD-2345"]
)
def test_a_wrong_code_is_told_so(page: SettingUp, body: str) -> None:
    status, text, headers = ask(page, "/enter", body)
    assert status in (401, 429) and 'name="code"' in text and "set-cookie" not in headers


def test_tries_are_counted_and_a_page_of_elsewhere_may_not_try(page: SettingUp) -> None:
    assert ask(page, "/enter", "code=x", origin="http://evil.example")[0] == 403
    assert 429 in [ask(page, "/enter", "code=x")[0] for _ in range(3)]


def test_with_the_code_it_is_the_page_that_sets_up(page: SettingUp, cookie: str) -> None:
    status, _, headers = ask(page, "/", cookie=cookie)
    assert (status, headers["location"]) == (303, "/setup")  # there is no machine file yet
    status, text, headers = ask(page, "/setup", cookie=cookie)
    assert status == 200 and "Set up this machine" in text
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    heard = json.loads(ask(page, "/setup/heard", cookie=cookie)[1])
    assert heard["listens"] and heard["frames"] == 0 and heard["receivers"] == heard["wheels"] == []
    assert [bus["heard"] for bus in heard["buses"]] == [False]
    assert json.loads(ask(page, "/setup/listen", "{}", cookie=cookie, **JSON)[1])["done"]
    with connect(page.url.replace("http", "ws") + "live", additional_headers={"cookie": cookie}) as live:
        while b"setup" not in (live.recv(timeout=60, decode=False)):
            pass  # it is told in one of the first messages


@pytest.mark.parametrize("path", ["/setup/check", "/setup/save"])
@pytest.mark.parametrize(
    ("sent", "status", "says"),
    [
        ("{}", 200, "write a number"),
        ('{"name": "rig", "tractor.mass": "1e400"}', 200, "is no number"),
        ("[]", 400, "sent as JSON"),
        ("{", 400, "sent as JSON"),
        ('{"name": 3}', 400, "each answer is a text"),
        ('{"name": "\\ud800"}', 400, "no Unicode"),
        (json.dumps({"name": "x" * 10_000}), 400, "too long"),
    ],
)
def test_bad_answers_are_told_and_nothing_is_saved(
    page: SettingUp, cookie: str, path: str, sent: str, status: int, says: str
) -> None:
    answer = ask(page, path, sent, cookie=cookie, **JSON)
    assert answer[0] == status and says in str(json.loads(answer[1])["wrong"])
    assert not page.file.exists()


@pytest.mark.parametrize(
    ("label", "says"),
    [
        (None, "nothing is served without a code"),
        ("", "it has no line such as code"),
        ("code = 5", "it has no line such as code"),
        ('code = "1234"', "8 letters and digits or more"),
        ("code", "it has a line such as code"),
    ],
)
def test_without_a_good_code_nothing_is_served(
    label: str | None, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "label.toml"
    if label is not None:
        path.write_text(label)
    assert main(["setup", str(tmp_path / "m.toml"), "--label", str(path), "--port", "0"]) == 2
    assert says in capsys.readouterr().err
