"""A tractor and its implements in files of their own: joined, chosen, changed by order or by what is
heard."""

import threading
from pathlib import Path

import can
import pytest
from loopback import TEXT, records_of
from verified import verified

from tilth.cli import main
from tilth.logger import hitched, warm_start_file
from tilth.logger.daemon import Daemon, run_daemon
from tilth.logger.display import NoDisplay
from tilth.logger.hitched import SETTLED_NS, chosen
from tilth.logger.machine_file import read_machine, read_rigs
from tilth.schemas.flow import Accepted, Frame
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import joined, parse_machine
from tilth.schemas.notices import Notice, NoticeCode
from tilth.schemas.plausible import unusual
from tilth.schemas.proto import tilth_pb2 as pb

BUS = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-hitched"\n\n'


def part(begin: str, end: str) -> str:
    return TEXT[TEXT.index(begin) : TEXT.index(end)]


IMPLEMENT = (
    part("[implement]", "[tyres.front]")
    + part("[tyres.implement]", "[[bus]]")
    + part('[[receiver]]\nmount = "implement_front"', "[wheel_angle]")
)
TRACTOR = (
    part("[machine]", "[implement]")
    + part("[tyres.front]", "[tyres.implement]")
    + BUS
    + part("[[receiver]]", '[[receiver]]\nmount = "implement_front"')
    + part("[wheel_angle]", "[log]")
    + '[implements]\nfiles = ["parker.toml", "krampe.toml"]\n'
)
PARKER = IMPLEMENT.replace("[implement]", '[implement]\nname = "parker"')
KRAMPE = IMPLEMENT.replace("[implement]", '[implement]\nname = "krampe"').replace(
    "C07891000B00", "C07891000B01"
)
KRAMPE_NAME = 0xC07891000B012711


@pytest.fixture
def file(tmp_path: Path) -> Path:
    for name, text in (("jd.toml", TRACTOR), ("parker.toml", PARKER), ("krampe.toml", KRAMPE)):
        (tmp_path / name).write_text(text)
    return tmp_path / "jd.toml"


def claim(name: int, source: int, t_ns: int) -> Frame:
    data = name.to_bytes(8, "little")
    return Frame(t_ns, t_ns, "can0", 0x18EEFF00 | source, True, False, data)


def test_joined_files_are_one_machine_file(file: Path) -> None:
    whole = read_machine(f"{file}+krampe")
    assert whole.machine == parse_machine(whole.text) and whole.machine.rig == "jd7930-parker500+krampe"
    assert {receiver.mount for receiver in whole.machine.receiver} == {
        "tractor_front", "tractor_rear", "implement_front", "implement_rear",
    }  # fmt: skip
    assert [*read_rigs(file)] == ["parker", "krampe", "undescribed"]


@pytest.mark.parametrize(
    ("tractor", "implement", "words"),
    [
        (TRACTOR + PARKER, PARKER, r"\[implement\]: a file with \[implements\] leaves"),
        (TRACTOR, PARKER + "[tractor]\na = 1\n", r"\[tractor\]: a file of an implement holds"),
        (TRACTOR, PARKER.replace("[tyres.implement]", "[tyres.rear]"), r"\[tyres.rear\]: a file of"),
        (TRACTOR, PARKER.replace("implement_front", "cab"), r"\[receiver cab\]: a file of"),
        (TRACTOR, IMPLEMENT, "implement.name: missing; give name"),
        (TRACTOR, 'implement = { name = "x", d = 1 }\n', r"as a table under a \[heading\]"),
        (TRACTOR, "[implement\n", "not a TOML file"),
    ],
)
def test_files_that_cannot_be_joined(tractor: str, implement: str, words: str) -> None:
    with pytest.raises(MachineError, match=words):
        joined(tractor, implement)


@pytest.mark.parametrize(
    ("of", "files", "words"),
    [
        ("jd.toml", {}, r"pulls one of parker, krampe, undescribed; say which, such as .*jd.toml\+parker"),
        ("jd.toml+cart", {}, "no implement cart; it pulls one of parker, krampe"),
        ("jd.toml+parker", {"krampe.toml": None}, "krampe.toml: the file of an implement cannot be read"),
        ("jd.toml+parker", {"krampe.toml": PARKER}, 'krampe.toml: name = "parker" is that of another'),
        ("jd.toml+parker", {"krampe.toml": KRAMPE.replace("d = 3.62", "d = -1")}, "krampe.toml: implement.d"),
        ("jd.toml+parker", {"krampe.toml": KRAMPE.replace("mass = { value = 2127.0,", "mass = { value = 0,")},
         r"krampe.toml: implement.mass = 0: must be above zero"),
        ("jd.toml+parker", {"krampe.toml": KRAMPE.replace('"can0"', '"can9"')},
         r'krampe.toml: receiver implement_front: bus = "can9" is no \[\[bus\]\] of this file'),
        ("jd.toml+parker", {"krampe.toml": TEXT}, r"krampe.toml: \[bus\]: a file of an implement holds"),
        ("jd.toml", {"jd.toml": TRACTOR.replace('["parker.toml", "krampe.toml"]', "7")}, "implements.files"),
        ("jd.toml+cart", {"jd.toml": TEXT}, r"it has no \[implements\]"),
        ("parker.toml", {}, "a file of an implement; give the tractor's"),
    ],
)  # fmt: skip
def test_a_wrong_choice_or_file_is_told_in_a_sentence(
    file: Path, of: str, files: dict[str, str | None], words: str
) -> None:
    for name, text in files.items():
        (file.parent / name).unlink() if text is None else (file.parent / name).write_text(text)
    with pytest.raises(MachineError, match=words):
        read_machine(file.parent / of)


@pytest.mark.parametrize(("kept", "name"), [(None, "parker"), ("krampe", "krampe"), ("cart", "parker")])
def test_a_run_begins_with_the_last_implement(file: Path, kept: str | None, name: str) -> None:
    said: list[Notice] = []
    rigs = read_rigs(file)
    if kept is not None:
        hitched.path_of(file.parent, "jd7930-parker500").write_text(kept)
    assert chosen(rigs, file.parent, lambda kind, told: said.append(told)) == name
    assert [one.code for one in said] == ([] if name == kept else [NoticeCode.IMPLEMENT_ASSUMED])


def test_what_is_learned_is_kept_by_implement_and_a_name_is_no_other_rig(file: Path, tmp_path: Path) -> None:
    rigs = read_rigs(file)
    paths = {warm_start_file.path_of(tmp_path, rig.machine) for rig in rigs.values()}
    assert len(paths) == len(rigs)
    before, named = parse_machine(TEXT), parse_machine(TEXT.replace("[implement]", '[implement]\nname = "x"'))
    path = tmp_path / "x.json"
    path.write_text(warm_start_file.text_of(before, {}, 5))
    assert warm_start_file.read(path, named, 6) is not None


@pytest.mark.usefixtures("prepared")
def test_an_order_ends_the_run_and_the_next_is_of_the_other_rig(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `tilth run` does it, orders from another program's place: each log replays by itself."""
    rigs = read_rigs(file)
    which, statuses = ["--machine", f"{file}+parker"], list[int]()
    orders = (["implement"], ["implement", "cart"], ["implement", "parker"], ["implement", "krampe"])
    asking = threading.Thread(target=lambda: statuses.extend(main([*words, *which]) for words in orders))
    logs = tmp_path / "logs"

    kept, sent = hitched.path_of(logs, "jd7930-parker500"), [0]
    with can.Bus(interface="virtual", channel="tilth-hitched") as talker:

        def over() -> bool:
            """At each turn of the loop, from which on orders are heard, a frame; 20 of the next run."""
            if asking.ident is None:
                asking.start()
            talker.send(can.Message(arbitration_id=0x18FF1234, data=bytes(8)))
            sent[0] += kept.exists() and not asking.is_alive()
            return sent[0] > 20

        summary = run_daemon(rigs["parker"], rigs=rigs, log_folder=logs, simulated="a test", stop=over)
    said = capsys.readouterr()
    assert statuses == [0, 2, 2, 0]
    assert "parker  (hitched on)\nkrampe\n" in said.out and "krampe is hitched: a new run begins" in said.out
    assert "no implement cart; there are parker, krampe" in said.err and "hitched on already" in said.err
    assert kept.read_text() == "krampe" and len(summary.log_files) == 2
    first, second = summary.log_files
    assert "krampe is hitched" in " ".join(event.text for event in records_of(first, "/event", pb.Event))
    assert {status.implement for status in records_of(second, "/status", pb.Status)} == {"krampe"}
    for log, name in ((first, "parker"), (second, "krampe")):
        verified([log], rigs[name], least=0)  # without receivers there are no results


@pytest.mark.usefixtures("prepared")
@pytest.mark.parametrize(
    ("heard", "following"),
    [
        ((KRAMPE_NAME,), "krampe"),
        ((KRAMPE_NAME, 0xC07891000B002711), ""),
        ((0xA00017000421E240,), ""),
        ((), ""),
    ],
)
def test_an_implement_is_known_by_a_device_that_it_alone_has(
    file: Path, tmp_path: Path, heard: tuple[int, ...], following: str
) -> None:
    rigs = read_rigs(file)
    with can.Bus(interface="virtual", channel="tilth-hitched"):
        daemon = Daemon(rigs["parker"], tmp_path / "logs", None, NoDisplay(), rigs=rigs)
        t_ns = daemon.parts.clock.t_ns()
        for source, name in enumerate(heard, 0x80):
            daemon.take(claim(name, source, t_ns))
        daemon.turn(0.0)
        assert daemon.following is None  # another device may claim its address yet
        daemon.parts.clock.offset_ns += SETTLED_NS + 1
        daemon.turn(0.0)
        assert daemon.parts.hitched.following == following
        daemon.close()
    kept = hitched.path_of(tmp_path / "logs", "jd7930-parker500")
    assert (kept.read_text() if kept.exists() else "") == following


@pytest.mark.usefixtures("prepared")
def test_what_is_accepted_of_the_tractor_holds_with_each_implement(file: Path, tmp_path: Path) -> None:
    rigs, logs = read_rigs(file), tmp_path / "logs"
    wheel = Accepted(5, "wheel_angle", (0.0175,), (0.001,))
    aside = Accepted(6, "implement_front", (0.1, 0.0), (0.01, 0.01))

    def run(name: str, *accepted: Accepted) -> list[str]:
        """What is accepted in a run, at its end."""
        daemon = Daemon(rigs[name], logs, None, NoDisplay(), rigs=rigs, keep=True)
        fold = daemon.parts.estimation.fold
        for one in accepted:
            fold.accept(one)
        daemon.turn(0.0)
        daemon.close()
        return [one.what for one in fold.accepted]

    with can.Bus(interface="virtual", channel="tilth-hitched"):
        assert run("parker", wheel, aside) == ["wheel_angle", "implement_front"]
        assert run("krampe") == ["wheel_angle"]
        assert run("krampe") == ["wheel_angle"]  # once
        assert run("parker") == ["wheel_angle", "implement_front"]
        kept = warm_start_file.tractor_path(logs, rigs["parker"].machine)
        assert kept is not None
        kept.write_text("{")
        assert run("krampe") == [] and run("parker") == ["wheel_angle", "implement_front"]


SPREADER = 0xA00A8A0000A00123  # a fertiliser spreader that no file has


@pytest.mark.usefixtures("prepared")
@pytest.mark.parametrize(
    ("heard", "told"),
    [((SPREADER,), True), ((SPREADER, 0xC07891000B002711), False), ((0xA0028A0000A00123,), False)],
)
def test_an_implement_that_nobody_described(
    file: Path, tmp_path: Path, heard: tuple[int, ...], told: bool
) -> None:
    """It is said once; a device beside those of the implement is its own, and one of a tractor is none."""
    rigs = read_rigs(file)
    with can.Bus(interface="virtual", channel="tilth-hitched"):
        daemon = Daemon(rigs["parker"], tmp_path / "logs", None, NoDisplay(), rigs=rigs)
        for source, name in enumerate(heard, 0x80):
            daemon.take(claim(name, source, daemon.parts.clock.t_ns()))
        for _ in range(2):
            daemon.parts.clock.offset_ns += SETTLED_NS + 1
            daemon.turn(0.0)
        assert daemon.parts.hitched.following == ""
        (log,) = daemon.close().log_files
    said = [e.text for e in records_of(log, "/event", pb.Event) if e.notice.code == "implement_strange"]
    assert len(said) == told
    if told:
        assert 'names = ["A00A8A0000A00123"]' in said[0] and "estimates are for parker" in said[0]
        assert "fertilizer" in said[0] or "fertiliser" in said[0]


@pytest.mark.usefixtures("prepared")
@pytest.mark.parametrize("own_heard", [False, True])
def test_one_that_nobody_described_is_hitched_on_where_the_other_would_be_heard(
    file: Path, tmp_path: Path, own_heard: bool
) -> None:
    """The present implement has a control unit of its own, which is silent: so it is not there."""
    own = 0xA0008C00042106D4
    (file.parent / "parker.toml").write_text(PARKER.replace("\nd =", f'\nnames = ["{own:016X}"]\nd =', 1))
    rigs = read_rigs(file)
    with can.Bus(interface="virtual", channel="tilth-hitched"):
        daemon = Daemon(rigs["parker"], tmp_path / "logs", None, NoDisplay(), rigs=rigs)
        for source, name in enumerate((SPREADER, own)[: 1 + own_heard], 0x80):
            daemon.take(claim(name, source, daemon.parts.clock.t_ns()))
        daemon.parts.clock.offset_ns += SETTLED_NS + 1
        daemon.turn(0.0)
        assert daemon.parts.hitched.following == ("" if own_heard else "undescribed")
        (log,) = daemon.close().log_files
    said = [e.text for e in records_of(log, "/event", pb.Event) if e.kind == "implement"]
    assert len(said) == (not own_heard)
    if said:
        assert "measure its mass, its track, hitch to axle" in said[0] and "A00A8A0000A00123" in said[0]


def test_an_implement_that_nobody_described_takes_receivers_along(file: Path) -> None:
    rigs = read_rigs(file)
    machine = rigs["undescribed"].machine
    assert not machine.implement.described and machine.implement.mass.sd > 1000.0
    of = {name: [r.name for r in rig.machine.receiver] for name, rig in rigs.items()}
    assert of["undescribed"] == of["parker"] != of["krampe"]
    assert not unusual(machine)
    (file.parent / "krampe.toml").write_text(KRAMPE.replace('"krampe"', '"undescribed"'))
    with pytest.raises(MachineError, match=r'name = "undescribed" is that of an implement without a file'):
        read_rigs(file)


@pytest.mark.usefixtures("prepared")
def test_each_run_tells_what_is_unusual_in_its_file(file: Path, tmp_path: Path) -> None:
    (file.parent / "krampe.toml").write_text(KRAMPE.replace("cg_height = 1.2", "cg_height = 3.0"))
    rigs = read_rigs(file)
    for name, rare in (("parker", 0), ("krampe", 1)):
        with can.Bus(interface="virtual", channel="tilth-hitched"):
            daemon = Daemon(rigs[name], tmp_path / name, None, NoDisplay(), rigs=rigs)
            daemon.turn(0.0)
            (log,) = daemon.close().log_files
        said = [e.text for e in records_of(log, "/event", pb.Event) if e.kind == "machine_file"]
        assert len([text for text in said if "implement.cg_height = 3 m: rare" in text]) == rare


def test_a_control_unit_is_of_one_implement(file: Path) -> None:
    for name, text in (("parker.toml", PARKER), ("krampe.toml", KRAMPE)):
        (file.parent / name).write_text(text.replace("\nd =", '\nnames = ["A00A8A0000A00123"]\nd =', 1))
    with pytest.raises(MachineError, match=r"in implement\.names of parker too; it is of one"):
        read_rigs(file)
