"""What others hear of the daemon: real sessions over TCP on this computer."""

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
import zenoh
from loopback import PATIENCE_S, START_NS, answers, free_port, rig, session, udp_bus

from tilth.cli import main
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.zenoh.open_network import is_local, ways_in
from tilth.logger.zenoh.session import free_endpoint, open_session, refusal, try_session
from tilth.logger.zenoh.sink import STALE_NS, ZenohSink
from tilth.schemas.channels import CHANNELS, payload
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Publication, Status
from tilth.schemas.machine import Machine, Zenoh
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb

LASTING = ("status", "event", "rig", "report")  # what was said last still holds
KEYED = [channel for channel in CHANNELS if channel.key is not None]
BASE = "tilth/jd7930-parker500"


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return rig(tmp_path, udp_bus("can0", 1))[0]


@pytest.fixture
def sink(machine: Machine) -> Iterator[ZenohSink]:
    one = ZenohSink(machine)
    yield one
    one.close()


def next_sample(queue: "SimpleQueue[zenoh.Sample]") -> zenoh.Sample:
    return queue.get(timeout=PATIENCE_S)


def estimate(value: float) -> Publication:
    rows = tuple(ParameterEstimate(value, 1.0, Status.ESTIMATED, None) for _ in PARAMETERS)
    return Publication(START_NS, "/soil_tire", Estimate(START_NS, "recommended", "m", rows, (), ()))


def test_a_controller_hears_each_estimate_and_can_ask_for_the_last(sink: ZenohSink) -> None:
    with session(sink.endpoints) as other:
        samples: SimpleQueue[zenoh.Sample] = SimpleQueue()
        subscriber = other.declare_subscriber(f"{BASE}/soil_tire", samples.put)
        assert answers(other, f"{BASE}/soil_tire") == {}  # nothing yet, and no wait for it
        for value in (1.0, 2.0):
            sink.put("/soil_tire", payload(estimate(value)))
        for value in (1.0, 2.0):
            sample = next_sample(samples)
            result = pb.SoilTireEstimate.FromString(sample.payload.to_bytes())
            assert [row.name for row in result.parameters] == list(PARAMETERS)
            assert result.parameters[0].value == value
            assert str(sample.encoding) == "application/protobuf;tilth.SoilTireEstimate"
        last, encoding = answers(other, f"{BASE}/soil_tire")[f"{BASE}/soil_tire"]
        assert last == payload(estimate(2.0)) and encoding == "application/protobuf;tilth.SoilTireEstimate"
        subscriber.undeclare()


def test_every_channel_with_a_key_is_published_and_answers(sink: ZenohSink) -> None:
    with session(sink.endpoints) as other:
        samples: SimpleQueue[zenoh.Sample] = SimpleQueue()
        subscriber = other.declare_subscriber(f"{BASE}/**", samples.put)
        assert set(answers(other, f"{BASE}/**")) == {f"{BASE}/rig"}  # so the subscription is known
        wanted = {f"{BASE}/{c.key}": (c.topic.encode(), c.encoding) for c in KEYED}
        got = {}
        for channel in CHANNELS:  # one by one: who is slower than its sender loses some
            sink.put(channel.topic, channel.topic.encode())
            if channel in KEYED:
                sample = next_sample(samples)
                got[str(sample.key_expr)] = (sample.payload.to_bytes(), str(sample.encoding))
        assert got == wanted and answers(other, f"{BASE}/**") == wanted
        assert samples.empty()  # nothing of the channels without a key
        subscriber.undeclare()


def test_an_old_value_is_not_given_as_the_present_one(machine: Machine) -> None:
    now = [0]
    sink = ZenohSink(machine, now_ns=lambda: now[0])
    computed = {f"{BASE}/{c.key}" for c in KEYED if c.key not in LASTING}
    with session(sink.endpoints) as other:
        for channel in KEYED:
            sink.put(channel.topic, b"x")
        now[0] = STALE_NS
        assert set(answers(other, f"{BASE}/**")) == {f"{BASE}/{channel.key}" for channel in KEYED}
        now[0] = STALE_NS + 2_000_000_000
        assert set(answers(other, f"{BASE}/**")) == {f"{BASE}/{key}" for key in LASTING}
        for key in computed:
            (reply,) = other.get(key, timeout=PATIENCE_S)
            assert reply.ok is None and reply.err is not None
            assert f"{key}: no value for 7 s".encode() in reply.err.payload.to_bytes()
        sink.put("/soil_tire", b"y")
        assert answers(other, f"{BASE}/soil_tire")[f"{BASE}/soil_tire"][0] == b"y"
    sink.close()


def test_a_token_says_that_the_daemon_lives(machine: Machine) -> None:
    sink = ZenohSink(machine)
    with session(sink.endpoints) as other:
        tokens: SimpleQueue[zenoh.Sample] = SimpleQueue()
        watch = other.liveliness().declare_subscriber(f"{BASE}/alive", tokens.put, history=True)
        assert next_sample(tokens).kind == zenoh.SampleKind.PUT
        sink.close()
        assert next_sample(tokens).kind == zenoh.SampleKind.DELETE
        watch.undeclare()


def test_a_replay_can_never_be_heard_on_a_live_key(machine: Machine) -> None:
    sink = ZenohSink(machine, "replay")
    with session(sink.endpoints) as other:
        for channel in KEYED:
            sink.put(channel.topic, b"x")
        keys = set(answers(other, f"{BASE}/**"))
        assert keys == {f"{BASE}/replay/{channel.key}" for channel in KEYED}
        live = {f"{BASE}/{channel.key}" for channel in KEYED}
        assert not any(answers(other, key) for key in live)
        tokens = [r.ok.key_expr for r in other.liveliness().get("**", timeout=PATIENCE_S) if r.ok is not None]
        assert [str(key) for key in tokens] == [f"{BASE}/replay/alive"]
    sink.close()


def test_a_taken_port_is_said_and_another_used(machine: Machine) -> None:
    first, second = ZenohSink(machine), ZenohSink(machine)
    assert first.note == "" and first.endpoints == machine.zenoh.listen
    assert machine.zenoh.listen[0] in second.note and second.endpoints[0] in second.note
    assert try_session(machine) != ""
    with session(second.endpoints) as other:
        second.put("/soil_tire", b"x")
        assert answers(other, f"{BASE}/soil_tire")[f"{BASE}/soil_tire"][0] == b"x"
    second.close()
    first.close()
    assert try_session(machine) == ""


def named(machine: Machine, name: str) -> Machine:
    return machine.model_copy(update={"machine": machine.machine.model_copy(update={"name": name})})


def test_two_machines_on_one_computer_are_both_heard_and_told_apart(
    machine: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, text = rig(tmp_path, udp_bus("can0", 1))
    endpoint = machine.zenoh.listen[0]
    got: list[tuple[str, str]] = []

    def taking(name: str) -> dict[str, Callable[[zenoh.Query, str], None]]:
        def take(query: zenoh.Query, client: str) -> None:
            assert query.payload is not None
            got.append((name, query.payload.to_string()))
            event = pb.Event(t_ns=1, text=query.payload.to_string())
            query.reply(query.key_expr, event.SerializeToString())

        return {"mark": take}

    first = ZenohSink(named(machine, "one"), answers=taking("one"))
    assert main(["mark", "alone", "--endpoint", endpoint]) == 0
    assert "marked: alone (in the log of one)" in capsys.readouterr().out
    second = ZenohSink(named(machine, "two"), answers=taking("two"))
    try:
        assert f"{endpoint} is taken by another program, by tilth/one;" in second.note
        assert "--machine whom marks, orders and queries are for" in second.note
        assert main(["mark", "whose", "--endpoint", endpoint]) == 2
        assert "several daemons are heard: one, two; say with --machine" in capsys.readouterr().err
        for name in ("one", "two"):
            file = tmp_path / f"{name}.toml"
            file.write_text(text.replace('name = "jd7930-parker500"', f'name = "{name}"'))
            assert main(["mark", "a stone", "--endpoint", endpoint, "--machine", str(file)]) == 0
            assert f"marked: a stone (in the log of {name})" in capsys.readouterr().out
        assert got == [("one", "alone"), ("one", "a stone"), ("two", "a stone")]
    finally:
        second.close()
        first.close()


def test_a_second_run_of_the_same_machine_stays_apart(machine: Machine) -> None:
    """Both would speak on the same keys."""
    first, second = ZenohSink(machine), ZenohSink(machine)
    try:
        assert f"by {BASE}; listening on" in second.note and "end one" in second.note
        assert (
            f"queries go to the other one, unless given with --endpoint {second.endpoints[0]}" in second.note
        )
        assert "--connect (all others)" in second.note
        first.put("/soil_tire", b"first")
        second.put("/soil_tire", b"second")
        with session(first.endpoints) as other:
            assert answers(other, f"{BASE}/soil_tire")[f"{BASE}/soil_tire"][0] == b"first"
    finally:
        second.close()
        first.close()


def test_a_port_that_another_kind_of_program_has_costs_no_more_than_a_moment(machine: Machine) -> None:
    with socket.socket() as other:
        host, _, port = machine.zenoh.listen[0].removeprefix("tcp/").rpartition(":")
        other.bind((host, int(port)))
        other.listen()
        sink = ZenohSink(machine)
    assert "is taken by another program; listening on" in sink.note
    sink.close()


def problems(machine: Machine, folder: Path) -> list[str]:
    """Those of Zenoh in the last status of a run."""
    daemon = Daemon(MachineFile(machine, ""), folder, "", NoDisplay())
    daemon.turn(0.0)
    return [text for text in daemon.close().problems if text.startswith("zenoh: ")]


def test_what_is_wrong_with_zenoh_stays_in_the_status(machine: Machine, tmp_path: Path) -> None:
    assert problems(machine, tmp_path) == []
    first = ZenohSink(machine)
    (output,) = problems(machine, tmp_path)
    assert "is taken by another program" in output and "both publish the same keys" in output
    first.failures = 3
    assert "3 values could not be published" in first.problem
    first.close()
    endpoint = f"unixsock-stream/{tmp_path}/no/folder/socket"
    nowhere = machine.model_copy(update={"zenoh": machine.zenoh.model_copy(update={"listen": [endpoint]})})
    (output,) = problems(nowhere, tmp_path)
    assert "nothing is published" in output and endpoint.partition("/")[2] in output
    assert "correct [zenoh]" in output and " at /" not in output and ".rs" not in output


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/[::1]:7447", True),
        ("tcp/localhost:7447", True),
        ("unixsock-stream//run/tilth", True),
        ("serial//dev/ttyUSB0", False),
        ("tls/127.0.0.1:7447#root_ca_certificate=/etc/c:a", True),
        ("udp/0.0.0.0:17448", False),
        ("tcp/127.0.0.1.evil.example:7447", False),
        ("tcp/:7447", False),
        ("tcp/[fe80::1%eth0]:7447", False),
        ("udp/224.0.0.225:7446", False),
        ("tcp/[::]:7447", False),
        ("tcp/192.168.1.4:7447", False),
        ("tcp/tractor.local:7447", False),
    ],
)
def test_who_can_reach_an_endpoint(endpoint: str, local: bool) -> None:
    assert is_local(endpoint) is local


ALONE = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
HERE = {"endpoints": ["tcp/127.0.0.1:0"]}
ALL = {"endpoints": ["tcp/0.0.0.0:0"]}
MTLS = {"link": {"tls": {"enable_mtls": True}}}
ROUTER = {"endpoints": ["tcp/192.0.2.7:7447"]}


@pytest.mark.parametrize(
    ("config", "ways"),
    [
        ({"scouting": ALONE, "listen": HERE}, []),
        ({"scouting": ALONE, "listen": ALL}, ["listens on tcp/0.0.0.0:0"]),
        ({"scouting": ALONE, "listen": {"endpoints": ["tcp/[::]:0"]}}, ["listens on tcp/[::]:0"]),
        ({"scouting": ALONE, "listen": {"endpoints": {"peer": ALL["endpoints"]}}}, ["listens on tcp/0.0"]),
        ({"scouting": ALONE, "listen": {"endpoints": {"router": ALL["endpoints"]}}}, []),
        ({"scouting": ALONE}, ["listens on tcp/[::]:0"]),  # as Zenoh does where nothing is said
        ({}, ["listens on tcp/[::]:0", "multicast", "gossip"]),
        ({"listen": HERE}, ["multicast"]),
        ({"scouting": {"multicast": {"enabled": False}}, "listen": HERE}, []),
        ({"scouting": {"multicast": {"autoconnect": []}}, "listen": HERE}, []),
        ({"mode": "router", "listen": HERE}, []),  # is found, and does not seek
        ({"mode": "router", "scouting": ALONE}, ["listens on tcp/[::]:7447"]),
        ({"mode": "client", "connect": {"endpoints": ["tcp/127.0.0.1:7447"]}}, []),
        ({"mode": "client"}, ["multicast"]),
        ({"mode": "client", "connect": ROUTER}, ["connects to tcp/192.0.2.7:7447"]),
        ({"scouting": ALONE, "listen": HERE, "connect": ROUTER}, ["connects to tcp/192.0.2.7:7447"]),
        ({"scouting": ALONE, "listen": {"endpoints": ["tls/0.0.0.0:0"]}}, ["listens on tls/0.0.0.0:0"]),
        ({"scouting": ALONE, "listen": {"endpoints": ["tls/0.0.0.0:0"]}, "transport": MTLS}, []),
        ({"scouting": ALONE, "listen": ALL, "transport": MTLS}, ["listens on tcp/0.0.0.0:0"]),
        ({"scouting": ALONE, "listen": ALL, "transport": {"auth": {"usrpwd": {"dictionary_file": "u"}}}}, []),
    ],
)
def test_what_lets_in_everybody(tmp_path: Path, config: dict[str, Any], ways: list[str]) -> None:
    path = tmp_path / "foreign.json5"
    path.write_text(json.dumps(config))
    found = ways_in(zenoh.Config.from_file(str(path)))
    assert len(found) == len(ways) and all(word in way for word, way in zip(ways, found, strict=True))


def test_a_configuration_that_lets_in_everybody_is_used_only_where_that_is_said_twice(
    machine: Machine, tmp_path: Path
) -> None:
    port = free_port(socket.SOCK_STREAM)
    path = tmp_path / "foreign.json5"
    listen = {"endpoints": [f"tcp/0.0.0.0:{port}"]}
    path.write_text(json.dumps({"scouting": ALONE, "listen": listen}))

    def with_zenoh(**settings: Any) -> Machine:
        return machine.model_copy(update={"zenoh": Zenoh(**settings)})

    once = with_zenoh(config=str(path))
    for refused in (open_session, try_session):
        with pytest.raises(
            zenoh.ZError, match=rf"open to everybody on this network: it listens on .*:{port} without"
        ):
            refused(once)
    output = refusal(once)
    assert "foreign.json5 makes it open to everybody" in output and "[zenoh] open = true" in output
    for twice in (with_zenoh(config=str(path), open=True), with_zenoh(listen=listen["endpoints"], open=True)):
        assert refusal(twice) == ""
        opened, listening, note = open_session(twice)
        assert listening == listen["endpoints"] and "All there may read, mark and speak" in note
        with session([f"tcp/127.0.0.1:{port}"]) as other:
            assert [str(zid) for zid in other.info.peers_zid()] == [str(opened.info.zid())]
        opened.close()
    left_out = with_zenoh(listen=listen["endpoints"])
    assert refusal(left_out) == ""
    opened, listening, note = open_session(left_out)
    opened.close()
    assert listen["endpoints"][0] not in listening and "open = true if that is meant" in note
    assert refusal(with_zenoh(config=str(tmp_path / "none.json5"))) == ""  # no reason not to record


def test_the_machine_file_listens_on_this_computer_only_unless_it_says_more() -> None:
    assert Zenoh().listen == ["tcp/127.0.0.1:7447"] and Zenoh().connect == []


def test_a_wrong_endpoint_is_an_error_and_one_that_does_not_answer_is_none(machine: Machine) -> None:
    def with_zenoh(**settings: Any) -> Machine:
        return machine.model_copy(update={"zenoh": machine.zenoh.model_copy(update=settings)})

    with pytest.raises(zenoh.ZError):
        ZenohSink(with_zenoh(listen=["nonsense"]))
    sink = ZenohSink(with_zenoh(connect=[f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"]))
    sink.put("/pose", b"x")
    assert sink.failures == 0
    sink.close()


def test_a_free_port_is_left_alone() -> None:
    port = free_port(socket.SOCK_STREAM)
    assert free_endpoint(f"tcp/127.0.0.1:{port}") == f"tcp/127.0.0.1:{port}"
    with socket.create_server(("127.0.0.1", port)):
        other = free_endpoint(f"tcp/127.0.0.1:{port}")
        assert other.startswith("tcp/127.0.0.1:") and other != f"tcp/127.0.0.1:{port}"
    for other in ("udp/127.0.0.1:7447", "tcp/localhost", "nonsense"):
        assert free_endpoint(other) == other
