"""Nobody uninvited: real sessions with real certificates, and what each of them gets and changes."""

import base64
import json
import re
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from queue import SimpleQueue

import pytest
import zenoh
from logs import MACHINE
from loopback import PATIENCE_S, TEXT, free_port, machine_text, records_of, rig, udp_bus, until

from tilth.cli import main
from tilth.cli.daemon_order import client_config
from tilth.client.experiment.wires import PrompterWires
from tilth.client.link import open_session
from tilth.client.refusal import try_key
from tilth.deploy import keys
from tilth.logger.clock import Clock
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.machine_file import read_machine
from tilth.logger.zenoh.session import open_session as open_daemon
from tilth.logger.zenoh.session import try_session
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb

NAME = "jd7930-parker500"
BASE = f"tilth/{NAME}"
ORDERED = ("mark", "accept", "implement", "report/make")
NOW = datetime.fromtimestamp(Clock().t_ns() // 1_000_000_000, UTC)


@dataclass
class Net:
    """A folder of keys and what the daemon's side of the network sees."""

    folder: Path
    port: int
    session: zenoh.Session
    samples: list[str] = field(default_factory=list)
    queries: list[str] = field(default_factory=list)
    witness: "SimpleQueue[bytes]" = field(default_factory=SimpleQueue)  # what another reader hears

    def forged(self) -> list[str]:
        """Answers of others to the daemon's own questions."""
        return [str(r.ok.key_expr) for r in self.session.get(f"{BASE}/pose", timeout=1.0) if r.ok is not None]


def make_folder(folder: Path, port: int, recorder: tuple[str, ...] = ()) -> Path:
    hosts = ("127.0.0.1", "tractor.local")
    keys.make(folder, keys.Register(NAME, "tilth", hosts, port, recorder=recorder), NOW)
    people = [("olga", "operator"), ("rita", "reader"), ("rex", "reader"), ("witness", "reader")]
    keys.admit(folder, people, NOW)
    return folder


def changed(path: Path, to: Path, **tls: str | None) -> Path:
    """A copy of a key file with other certificates, None: none."""
    content = json.loads(path.read_text())
    mine = content["transport"]["link"]["tls"]
    for name, value in tls.items():
        if value is None:
            del mine[name]
        else:
            mine[name] = value
    to.write_text(json.dumps(content))
    return to


def make_strangers(folder: Path, other: Path) -> None:
    """Files as of who was not invited, beside those of who was."""
    mine = json.loads((folder / "rita.json").read_text())["transport"]["link"]["tls"]
    theirs = {"connect_certificate_base64": None, "connect_private_key_base64": None}
    changed(folder / "rita.json", folder / "without.json", **theirs)
    authority = {"root_ca_certificate_base64": mine["root_ca_certificate_base64"]}
    changed(other / "rita.json", folder / "foreign.json", **authority)
    stolen = (folder / "rex.json").read_bytes()
    keys.revoke(folder, ["rex"])
    (folder / "revoked.json").write_bytes(stolen)
    keys.admit(folder, [("expired", "reader")], NOW - timedelta(days=40), 10)


@pytest.fixture(scope="module", params=["recorder", pytest.param("router", marks=pytest.mark.long)])
def net(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Net]:
    """Where the recorder takes keys itself, or a router does in front of it."""
    port = free_port(socket.SOCK_STREAM)
    inside = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    routed = request.param == "router"
    folder = make_folder(tmp_path_factory.mktemp("mine") / "keys", port, (inside,) if routed else ())
    make_strangers(folder, make_folder(tmp_path_factory.mktemp("other") / "keys", port))
    at_the_door = zenoh.open(zenoh.Config.from_file(str(folder / "daemon.json")))
    listening = MACHINE.model_copy(update={"zenoh": MACHINE.zenoh.model_copy(update={"listen": [inside]})})
    session = open_daemon(listening)[0] if routed else at_the_door
    one = Net(folder, port, session)

    def answer(query: zenoh.Query) -> None:
        one.queries.append(str(query.key_expr))
        if query.key_expr.intersects(zenoh.KeyExpr(f"{BASE}/status")):
            query.reply(f"{BASE}/status", b"well")

    session.declare_subscriber("**", lambda sample: one.samples.append(str(sample.key_expr)))
    session.liveliness().declare_subscriber("**", lambda sample: one.samples.append(str(sample.key_expr)))
    session.declare_queryable(f"{BASE}/**", answer, complete=True)
    for order in ORDERED:
        session.declare_queryable(
            f"{BASE}/{order}",
            lambda query: query.reply(query.key_expr, b"noted") if "*" not in str(query.key_expr) else None,
        )
    with open_session(config=folder / "witness.json") as witness:
        until(lambda: answers_to(witness, f"{BASE}/status") == [b"well"])
        witness.declare_subscriber(f"{BASE}/**", lambda sample: one.witness.put(sample.payload.to_bytes()))
        assert answers_to(witness, f"{BASE}/status") == [b"well"]  # so the subscription is known
        yield one
    session.close()
    if routed:
        at_the_door.close()


def answers_to(session: zenoh.Session, key: str) -> list[bytes]:
    replies = [reply.ok for reply in session.get(key, payload=b"a stone", timeout=PATIENCE_S)]
    return [one.payload.to_bytes() for one in replies if one is not None]


def others(received: "SimpleQueue[bytes]") -> Callable[[zenoh.Sample], None]:
    """Keeps what a session has not put itself."""

    def keep(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT and sample.payload.to_bytes() != b"forged":
            received.put(sample.payload.to_bytes())

    return keep


def misbehave(session: zenoh.Session) -> None:
    """All that only the daemon may do."""
    for key in ("soil_tire", "status", "mark", "pose", "elsewhere"):
        session.put(f"{BASE}/{key}", b"forged")
        session.delete(f"{BASE}/{key}")
    session.put("other/key", b"forged")
    session.declare_queryable(f"{BASE}/pose", lambda query: query.reply(f"{BASE}/pose", b"forged"))
    session.liveliness().declare_token(f"{BASE}/alive")


@pytest.mark.parametrize("name", ["olga", "rita"])
def test_who_was_invited_hears_and_only_the_operator_orders(net: Net, name: str) -> None:
    net.samples.clear()
    net.queries.clear()
    received: SimpleQueue[bytes] = SimpleQueue()
    with open_session(config=net.folder / f"{name}.json") as session:
        until(lambda: answers_to(session, f"{BASE}/status") == [b"well"])
        assert answers_to(session, f"{BASE}/*") == [b"well"] and answers_to(session, "other/**") == []
        session.declare_subscriber(f"{BASE}/**", others(received))
        misbehave(session)
        noted = [b"noted"] if name == "olga" else []
        for order in ORDERED:
            assert answers_to(session, f"{BASE}/{order}") == noted  # at once: refused is not unanswered
            assert (f"{BASE}/{order}" in net.queries) is (name == "olga")
        assert net.forged() == []
        net.session.put(f"{BASE}/status", b"well")
        assert received.get(timeout=PATIENCE_S) == net.witness.get(timeout=PATIENCE_S) == b"well"
        until(lambda: net.samples == [f"{BASE}/status"])  # the daemon's own
        assert received.empty() and net.witness.empty() and "other/**" not in net.queries


REFUSED = [
    ("without", "it wants a certificate and this file has none"),
    ("foreign", "this key is of another authority"),
    ("expired", "this key has expired"),
    ("revoked", "the key was revoked"),
]


@pytest.mark.parametrize(("name", "reason"), REFUSED)
def test_who_was_not_invited_gets_nothing_changes_nothing_and_is_told_why(
    net: Net, name: str, reason: str
) -> None:
    net.samples.clear()
    net.queries.clear()
    received: SimpleQueue[bytes] = SimpleQueue()
    with open_session(config=net.folder / f"{name}.json") as session:
        session.declare_subscriber(f"{BASE}/**", others(received))
        misbehave(session)
        verdict = try_key(net.folder / f"{name}.json")  # takes longer than a session would need
        assert not verdict.opens and reason in verdict.text
        misbehave(session)
        for key in ("status", "mark", "**"):
            assert answers_to(session, f"{BASE}/{key}") == [b"forged"] * (key == "**")  # its own answer
        net.session.put(f"{BASE}/status", b"well")
        assert net.queries == [] and net.forged() == []
        assert net.witness.get(timeout=PATIENCE_S) == b"well"
        until(lambda: net.samples == [f"{BASE}/status"])  # the daemon's own
        assert received.empty() and net.witness.empty()


def test_an_operator_may_prompt_a_driver_and_take_his_orders_and_a_reader_may_look(net: Net) -> None:
    wires = PrompterWires(zenoh.open(client_config(net.folder / "olga.json", [])), BASE)
    config = zenoh.Config.from_file(str(net.folder / "olga.json"))
    seen: SimpleQueue[bytes] = SimpleQueue()
    with closing(wires), zenoh.open(config) as page, open_session(config=net.folder / "rita.json") as reader:
        for session in (page, reader):
            session.declare_subscriber(f"{BASE}/experiment", lambda s: seen.put(s.payload.to_bytes()))

        def shown() -> bool:
            wires.show(pb.ExperimentState(plan="keys"))
            return seen.qsize() > 8

        until(shown)
        assert {pb.ExperimentState.FromString(seen.get()).plan for _ in range(8)} == {"keys"}
        order = pb.ExperimentOrder(kind="arm").SerializeToString()

        def ordered() -> bool:
            return any(r.ok for r in page.get(f"{BASE}/experiment/order", payload=order, timeout=PATIENCE_S))

        until(ordered)
        assert wires.orders()[0].kind == "arm"
        assert list(reader.get(f"{BASE}/experiment/order", payload=order, timeout=1.0)) == []
        assert wires.orders() == []


def test_a_key_is_tried_by_its_holder(net: Net, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for name, may in (("olga", "hear everything and mark"), ("rita", "and not mark")):
        assert main(["keys", "--try", str(net.folder / f"{name}.json")]) == 0
        assert may in capsys.readouterr().out
    other = make_folder(tmp_path / "keys", net.port)
    assert main(["keys", "--try", str(other / "rita.json")]) == 1
    assert "no certificate of this machine's authority" in capsys.readouterr().out
    nobody = make_folder(tmp_path / "nobody", free_port(socket.SOCK_STREAM))
    assert main(["keys", "--try", str(nobody / "rita.json")]) == 1
    assert "connection refused" in capsys.readouterr().out
    for wrong in (net.folder / "daemon.json", net.folder / "ca.pem", tmp_path / "no.json"):
        assert main(["keys", "--try", str(wrong)]) == 2
        assert str(wrong) in capsys.readouterr().err


def test_noise_and_floods_at_the_door_leave_the_daemon_at_its_work(net: Net) -> None:
    noise = bytes(i * 37 % 256 for i in range(4096))
    for data in (b"", b"\x16\x03\x01", b"GET / HTTP/1.1\r\n\r\n", noise):
        with socket.create_connection(("127.0.0.1", net.port), PATIENCE_S) as plain:
            plain.sendall(data)
    content = json.loads((net.folder / "olga.json").read_text())["transport"]["link"]["tls"]
    context = ssl.create_default_context(
        cadata=base64.b64decode(content["root_ca_certificate_base64"]).decode()
    )
    with (
        socket.create_connection(("127.0.0.1", net.port), PATIENCE_S) as plain,
        context.wrap_socket(plain, server_hostname="127.0.0.1") as secured,
    ):
        secured.sendall(noise)
    with open_session(config=net.folder / "olga.json") as flooding:
        until(lambda: answers_to(flooding, f"{BASE}/status") == [b"well"])
        net.queries.clear()
        big = [r for r in flooding.get(f"{BASE}/mark", payload=b"x" * 3_000_000, timeout=1.0) if r.ok]
        assert big == [] and f"{BASE}/mark" not in net.queries
        with open_session(config=net.folder / "rita.json") as reader:
            until(lambda: answers_to(reader, f"{BASE}/status") == [b"well"])


def test_the_daemon_takes_its_keys_from_the_machine_file(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    make_folder(tmp_path / "keys", port)
    file = tmp_path / "machine.toml"
    file.write_text(TEXT.replace('prefix = "tilth"', 'prefix = "tilth"\nconfig = "keys/daemon.json"'))
    machine, _ = read_machine(file)
    assert try_session(machine) == ""
    sink = ZenohSink(machine)
    assert sink.endpoints == [f"tls/0.0.0.0:{port}"] and sink.note == ""
    with open_session(config=tmp_path / "keys" / "rita.json") as reader:
        sink.put("/status", b"well")
        until(lambda: answers_to(reader, f"{BASE}/status") == [b"well"])
    with open_session(f"tcp/127.0.0.1:{port}") as plain:
        assert answers_to(plain, f"{BASE}/status") == []
    sink.close()
    another = machine.model_copy(update={"machine": machine.machine.model_copy(update={"name": "mt700"})})
    assert f"was made for {BASE}, this is tilth/mt700: nobody may hear it" in try_session(another)
    for bad, output in ((tmp_path / "no.json", "no such file"), (file, "tilth keys")):
        settings = machine.zenoh.model_copy(update={"config": str(bad)})
        with pytest.raises(zenoh.ZError, match=output):
            try_session(machine.model_copy(update={"zenoh": settings}))
    file.write_text(TEXT.replace('prefix = "tilth"', 'listen = ["tcp/127.0.0.1:1"]\nconfig = "x"'))
    with pytest.raises(MachineError, match="give config, or listen and connect"):
        read_machine(file)


def test_without_keys_it_speaks_on_this_computer_only(tmp_path: Path) -> None:
    machine, _ = rig(tmp_path, udp_bus("can0", 1))
    port = free_port(socket.SOCK_STREAM)
    for update in ({"listen": [f"tcp/0.0.0.0:{port}"]}, {"connect": ["tcp/192.0.2.1:7447"]}):
        settings = machine.zenoh.model_copy(update=update)
        sink = ZenohSink(machine.model_copy(update={"zenoh": settings}))
        assert all(endpoint.startswith("tcp/127.0.0.1:") for endpoint in sink.endpoints)
        assert next(iter(update.values()))[0] in sink.problem and "tilth keys" in sink.problem
        sink.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), 1.0)


def test_nobody_in_the_list_is_nobody_and_not_everybody() -> None:
    register = keys.Register(NAME, "tilth", ("tractor",))
    rules = keys.access_control(register)
    assert rules["default_permission"] == "deny" and rules["subjects"] == rules["policies"] == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "give the FOLDER"),
        (["KEYS"], "make keys first, with --machine and --host"),
        (["KEYS", "--reader", "rita"], "make keys first"),
        (["KEYS", "--host", "10.0.0.2"], "--host and --router go with --machine"),
        (["KEYS", "--machine", "MACHINE"], "--host 192.168.1.10"),
        (["KEYS", "--machine", "MACHINE", "--host", "a b"], '--host "a b": give an address'),
        (["KEYS", "--machine", "no.toml", "--host", "a"], "no.toml"),
        (["MADE", "--machine", "MACHINE", "--host", "a"], "holds keys already"),
        (["MADE", "--reader", "rita"], '"rita" has a key already'),
        (["MADE", "--reader", "rex"], '"rex" was revoked'),
        (["MADE", "--reader", "daemon"], '"daemon": give a name'),
        (["MADE", "--reader", "../x"], '"../x": give a name'),
        (["MADE", "--reader", "two", "--operator", "two"], '"two" has a key already'),
        (["MADE", "--revoke", "nobody"], '"nobody" has no key here; there are olga, rita'),
        (["MADE", "--renew", "nobody"], '"nobody" has no key here'),
        (["MADE", "--days", "0"], "--days above zero"),
        (["MACHINE", "--reader", "x"], "not a directory"),
    ],
)
def test_wrong_use_is_one_line_that_says_what_to_do(
    words: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "machine.toml").write_text(TEXT)
    made = make_folder(tmp_path / "made", 7447)
    keys.revoke(made, ["rex"])
    before = {path.name: path.read_bytes() for path in made.iterdir()}
    places = {"KEYS": tmp_path / "keys", "MADE": made, "MACHINE": tmp_path / "machine.toml"}
    assert main(["keys", *(str(places.get(word, word)) for word in words)]) == 2
    err = capsys.readouterr().err
    assert expected in err and err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in made.iterdir()} == before
    assert not (tmp_path / "keys").exists()


def test_an_operator_marks_a_reader_is_told_why_not_and_garbage_changes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The daemon itself, its log, and `tilth mark`."""
    folder = make_folder(tmp_path / "keys", free_port(socket.SOCK_STREAM))
    file = tmp_path / "machine.toml"
    text = machine_text(tmp_path / "logs", udp_bus("can0", free_port()))
    file.write_text(re.sub("(?m)^listen = .*$", 'config = "keys/daemon.json"', text))
    machine, text = read_machine(file)
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())
    done = threading.Event()

    def loop() -> None:
        while not done.is_set():
            daemon.turn()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        command = ["mark", "a stone", "--config"]
        assert main([*command, str(folder / "olga.json")]) == 0
        assert "marked: a stone" in capsys.readouterr().out
        for words, output in (
            ([*command, str(folder / "rita.json")], "rita may hear and not mark; ask for an operator's key"),
            (["mark", "x", "--machine", str(file)], "this machine wants a key"),
            ([*command, str(folder / "ca.pem")], "no key of a person or program"),
        ):
            assert main(words) == 2
            assert output in capsys.readouterr().err
        with open_session(config=folder / "olga.json") as olga:
            until(lambda: bool(answers_to(olga, f"{BASE}/status")))
            for payload in (b"", b"\xff\xfe", b"\x00\x1b[2J", b"x" * 5000, b"x" * 2_000_000):
                replies = list(olga.get(f"{BASE}/mark", payload=payload, timeout=2.0))
                assert not any(reply.ok for reply in replies)
    finally:
        done.set()
        thread.join()
        summary = daemon.close()
    (path,) = summary.log_files
    marks = [event.text for event in records_of(path, "/event", pb.Event) if event.kind == "mark"]
    assert marks == ["a stone"]
    assert main(["mark", "too late", "--config", str(folder / "olga.json")]) == 2
    assert "connection refused" in capsys.readouterr().err
