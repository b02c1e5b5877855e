"""The client and a daemon's Zenoh in two processes: late joining, restarts, cuts, stalls, strangers."""

import json
import math
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
import zenoh
from client_daemon import NAME, THETA, Publisher, Way, encoded, estimate, until
from loopback import PATIENCE_S, TEXT, free_port, session
from paths import ROOT

from tilth.client import Client, Latest, Staleness
from tilth.client.link import open_session
from tilth.estimator.models.parameters import rig_of
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import parse_machine

RULE = Staleness(silence_s=1.0, data_s=math.inf)
KEY = f"tilth/{NAME}/soil_tire"
ENCODING = zenoh.Encoding("application/protobuf;tilth.SoilTireEstimate")


def usable(client: Client) -> bool:
    return all(client.latest().usable)


def scaled(client: Client, scale: float) -> bool:
    return bool(np.allclose(client.latest().theta([1.0] * 6), scale * np.array(THETA)))


def refused(client: Client, words: str) -> bool:
    return any(words in refusal for refusal in client.refused)


@pytest.fixture(scope="module")
def process() -> Iterator[Publisher]:
    with Publisher() as one:
        yield one


@pytest.fixture
def publisher(process: Publisher) -> Publisher:
    process.order(scale=1.0, silent=False)
    return process


def test_late_or_early_a_controller_has_the_last_value_the_model_and_the_changes(
    publisher: Publisher,
) -> None:
    """Each of the daemon's orders in turn, one process for all."""
    with Client.connect(NAME, stale=RULE, endpoint=publisher.endpoint) as client:
        events: SimpleQueue[Event] = SimpleQueue()
        estimates: SimpleQueue[Latest] = SimpleQueue()
        client.on_soil_change(events.put)
        client.on_estimate(estimates.put)
        assert client.wait(PATIENCE_S)
        until(lambda: client.alive and usable(client) and client.latest().age_s < 0.6)
        until(lambda: client.latest().reason == "" and scaled(client, 1.0))
        assert client.rig is not None and client.rig.rig == rig_of(parse_machine(TEXT))
        assert client.linear(2.0).A.shape == (9, 9)
        until(lambda: estimates.get(timeout=PATIENCE_S).usable == (True,) * 6)  # the first may be an old one
        publisher.order(event="lost")
        publisher.order(event="soil_change")
        assert events.get(timeout=PATIENCE_S).kind == "soil_change"
        publisher.order(scale=1.5)
        until(partial(scaled, client, 1.5))
        # Silence: it grows too old by this clock alone, although the daemon still lives.
        publisher.order(silent=True)
        until(lambda: not any(client.latest().usable))
        assert client.alive and "the daemon, its buses or the network have stopped" in client.latest().reason
        # One that joins now gets the last value with its age, and is not deceived by it.
        with Client.connect(NAME, stale=RULE, endpoint=publisher.endpoint) as late:
            assert late.wait(PATIENCE_S)
            assert 1.0 < late.latest().age_s < PATIENCE_S and not any(late.latest().usable)
        publisher.order(silent=False)
        until(lambda: usable(client))
        assert client.refused == {}


def documented(endpoint: str, beside_demo: bool = False) -> str:
    """The program that the documentation begins with, hearing this daemon."""
    page = ROOT / "docs/client.md"
    lines = page.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    assert "with Client" in lines and ", replay=True)" in lines
    lines = lines.replace("    print(theta, latest.codes, latest.reason)\n", "")
    lines = lines if beside_demo else lines.replace(", replay=True)", ")")
    lines = lines.replace("wait(10.0)", f"wait({PATIENCE_S})")
    return lines.replace("stale=stale", f'endpoint="{endpoint}", stale=stale')


def test_the_lines_of_the_documentation(publisher: Publisher) -> None:
    names: dict[str, Any] = {}

    def estimated() -> bool:
        exec(documented(publisher.endpoint), names)  # the first estimate may be an old one
        return bool((names["theta"] != names["nominal"]).all())

    until(estimated)
    assert names["A"].shape == (9, 9)


def test_the_lines_of_the_documentation_as_they_stand_hear_a_simulation() -> None:
    with Publisher(suffix="replay") as simulation:
        names: dict[str, Any] = {}
        exec(documented(simulation.endpoint, beside_demo=True), names)
        assert names["theta"] == pytest.approx(THETA) and names["latest"].codes == ("",) * 6
        deaf = documented(simulation.endpoint).replace(f"wait({PATIENCE_S})", "wait(0.5)")
        exec(deaf.partition("    A, B")[0], names)
        assert names["theta"] == pytest.approx(names["nominal"])


PLAIN = """
import math, sys, threading
from tilth.client import Client, Staleness
client = Client.connect({name!r}, stale=Staleness(silence_s=9.0, data_s=math.inf), endpoint={endpoint!r})
assert client.wait(60.0)
"""
OUTLIVED = """
def steer():
    threading.main_thread().join()
    print(all(client.latest().usable))
threading.Thread(target=steer).start()
"""
SLOW = """
called = threading.Event()
client.on_estimate(lambda latest: (called.set(), threading.Event().wait()))
called.wait()
"""


@pytest.mark.parametrize(
    ("program", "status", "expected"),
    [
        (PLAIN, 0, ""),
        (PLAIN + "raise RuntimeError('the controller failed')", 1, ""),
        (PLAIN + "sys.exit(7)", 7, ""),
        (PLAIN + OUTLIVED, 0, "True"),  # it hears as long as anybody of the program works
        (PLAIN + SLOW, 0, ""),  # a callback that never returns
        (PLAIN + "client.close()\nclient.close()", 0, ""),
        ("{documented}    raise RuntimeError('the controller failed')", 1, ""),
        (PLAIN.replace("assert client.wait(60.0)", ""), 0, ""),  # at once, perhaps before it is connected
    ],
)
def test_it_ends_with_its_program(publisher: Publisher, program: str, status: int, expected: str) -> None:
    """A real process each: one that hung would not be started again by its supervisor."""
    endpoint = publisher.endpoint
    text = program.format(name=NAME, endpoint=endpoint, documented=documented(endpoint))
    ended = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert ended.returncode == status and ended.stdout.strip() == expected, ended.stderr
    assert ("the controller failed" in ended.stderr) == (status == 1)


def test_it_ends_where_there_is_no_daemon() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    text = PLAIN.format(name=NAME, endpoint=endpoint).replace("client.wait(60.0)", "not client.wait(0.5)")
    assert subprocess.run([sys.executable, "-c", text], timeout=PATIENCE_S, check=False).returncode == 0


def test_a_daemon_that_comes_late_dies_and_comes_again() -> None:
    port = free_port(socket.SOCK_STREAM)
    with Client.connect(NAME, stale=RULE, endpoint=f"tcp/127.0.0.1:{port}") as client:
        assert not client.wait(0.0) and not client.alive
        with pytest.raises(LookupError, match="no rig"):
            client.linear(1.0)
        for scale in (1.0, 1.2):
            with Publisher(port) as publisher:
                publisher.order(scale=scale)
                until(partial(scaled, client, scale))
                until(lambda: client.alive and usable(client))
                publisher.kill()
            until(lambda: not client.alive)
            until(lambda: not any(client.latest().usable))


def test_a_network_that_is_cut_and_one_that_stalls(publisher: Publisher) -> None:
    with closing(Way(publisher.port)) as way, closing(
        Client.connect(NAME, stale=RULE, endpoint=way.endpoint)
    ) as client:  # fmt: skip
        assert client.wait(PATIENCE_S)
        way.cut()
        until(lambda: not any(client.latest().usable) and not client.alive)
        way.restore()
        until(lambda: usable(client) and client.alive)
        # Nothing goes through, no connection breaks; then all of it comes at once, and is as old as it is.
        ages: SimpleQueue[float] = SimpleQueue()
        client.on_estimate(lambda latest: ages.put(latest.age_s))

        def held_back() -> bool:
            way.open.clear()
            until(lambda: client.latest().age_s > 1.5)
            assert not any(client.latest().usable)
            while not ages.empty():
                ages.get()
            way.open.set()
            return ages.get(timeout=PATIENCE_S) > 1.0

        until(held_back)  # not so where the publisher itself was late
        until(lambda: usable(client))


def test_a_simulation_is_heard_by_those_who_ask_for_it_only() -> None:
    with (
        Publisher(suffix="replay") as publisher,
        Client.connect(NAME, stale=RULE, endpoint=publisher.endpoint) as tractor,
        Client.connect(NAME, stale=RULE, endpoint=publisher.endpoint, replay=True) as desk,
    ):
        assert desk.wait(PATIENCE_S)
        until(lambda: usable(desk))
        assert tractor.latest().estimate is None and tractor.rig is None and not tractor.alive
        until(lambda: "connect with replay=True" in tractor.latest().reason)


def test_strangers_cannot_make_it_use_what_is_not_so(publisher: Publisher) -> None:
    with (
        session([publisher.endpoint]) as stranger,
        Client.connect(NAME, stale=RULE, endpoint=publisher.endpoint) as client,
    ):
        assert client.wait(PATIENCE_S)
        result = client.latest().estimate
        assert result is not None
        hostile = (
            (KEY, b"\xff" * 100, ENCODING, "not a SoilTireEstimate"),
            (KEY, b"x" * 1_000_000, ENCODING, "too many"),
            (KEY, encoded(estimate()), zenoh.Encoding("text/html"), "text/html"),
            ("**", encoded(estimate(result.t_ns + 1)), ENCODING, "not to this machine alone"),
            (f"tilth/*/{KEY.rpartition('/')[2]}", encoded(estimate()), ENCODING, "not to this machine"),
            (KEY, encoded(estimate(result.t_ns - 1)), ENCODING, "older than the last"),
        )
        until(lambda: (stranger.put(KEY, b""), refused(client, "encoding"))[1])  # until there is a way in
        for key, data, encoding, words in hostile:
            stranger.put(key, data, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)
            until(partial(refused, client, words))
        stranger.delete(KEY)
        until(lambda: "a deletion" in client.refused)
        until(lambda: usable(client))
        assert client.latest().theta([1.0] * 6) == pytest.approx(THETA)


def test_the_same_estimate_again_does_not_grow_younger() -> None:
    port = free_port(socket.SOCK_STREAM)
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with (
        zenoh.open(config) as stuck,
        Client.connect(NAME, stale=RULE, endpoint=f"tcp/127.0.0.1:{port}") as client,
    ):

        def again() -> bool:
            stuck.put(KEY, encoded(estimate(5)), encoding=ENCODING)
            return client.latest().age_s > 1.0 and "the same estimate again" in str(client.refused)

        until(lambda: (again(), client.latest().estimate is not None)[1])
        until(again)
        assert not any(client.latest().usable)


def test_a_callback_that_fails_or_waits_does_no_harm(
    publisher: Publisher, caplog: pytest.LogCaptureFixture
) -> None:
    with Client.connect(NAME, stale=RULE, endpoint=publisher.endpoint) as client:
        assert client.wait(PATIENCE_S)
        held = threading.Event()
        client.on_estimate(lambda latest: 1 / 0)  # type: ignore[arg-type]
        until(lambda: client.refused.get("a callback failed", 0) > 0)
        assert "ZeroDivisionError" in caplog.text
        client.on_event(lambda event: held.wait(PATIENCE_S))  # type: ignore[arg-type]
        publisher.order(event="mark", scale=1.1)
        until(lambda: usable(client) and scaled(client, 1.1))
        held.set()
    client.close()  # twice is once
    assert client.latest().estimate is not None


def test_what_cannot_be_connected_to_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nonsense: not an endpoint; one looks like tcp/127\.0\.0\.1:7447"):
        Client.connect(NAME, stale=RULE, endpoint="nonsense")
    with pytest.raises(ValueError, match=r"none\.json5"):
        Client.connect(NAME, stale=RULE, config=tmp_path / "none.json5")


def test_a_configuration_file_instead_of_an_endpoint(publisher: Publisher, tmp_path: Path) -> None:
    path = tmp_path / "zenoh.json5"
    connect = {"endpoints": [publisher.endpoint]}
    scouting = {"multicast": {"enabled": False}}
    path.write_text(json.dumps({"mode": "client", "connect": connect, "scouting": scouting}))
    with Client.connect(NAME, stale=RULE, config=path) as client:
        assert client.wait(PATIENCE_S)
        until(lambda: usable(client))
    with open_session(publisher.endpoint) as plain:
        assert plain is not None
