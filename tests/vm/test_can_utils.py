"""The real SocketCAN path: what can-utils send and see, against what the daemon's log holds."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from guest import boot, missing
from loopback import TEXT, logged_frames, records_of

from tilth.schemas.flow import Frame
from tilth.schemas.proto import tilth_pb2 as pb

pytestmark = [pytest.mark.vm, pytest.mark.skipif(missing() != "", reason=missing())]
BUSES = ("vcan0", "vcan1", "vcan2", "vcan3", "can0", "can1")
_LINE = re.compile(r"\((\d+)\.(\d{6})\) (\w+) ([0-9A-F]+)#(R?)([0-9A-F]*)")


class Drive:
    """What came of the scenario."""

    def __init__(self, out: Path) -> None:
        self.out = out
        logs = sorted(out.glob("*.mcap"))  # several where it took long
        self.frames = [frame for log in logs for frame in logged_frames(log)]
        self.events: list[pb.Event] = [e for log in logs for e in records_of(log, "/event", pb.Event)]
        self.statuses: list[pb.Status] = [s for log in logs for s in records_of(log, "/status", pb.Status)]
        self.times = dict(line.split() for line in (out / "times").read_text().splitlines())

    def of(self, bus: str) -> list[Frame]:
        return [frame for frame in self.frames if frame.bus == bus]

    def buses(self, name: str) -> list[pb.BusStatus]:
        """All statuses of one bus, in their order."""
        return [bus for status in self.statuses for bus in status.buses if bus.name == name]

    def done_ns(self, what: str) -> int:
        return int(float(self.times[what]) * 1e9)

    def said(self, text: str, after_ns: int) -> int:
        """When it was first said since, ns."""
        return min(e.t_ns for e in self.events if text in e.text and e.t_ns > after_ns)

    def away_s(self, begin_ns: int, end_ns: int) -> float:
        """The longest time between that the machine gave to nobody, by the bus that always has traffic."""
        times = [f.t_ns for f in self.of("vcan3")]
        within = [t_ns for t_ns in times if begin_ns < t_ns < end_ns]
        around = [begin_ns, *within, min(t for t in times if t >= end_ns)]
        return float(np.diff(around).max() * 1e-9)


def machine_text(*names: str) -> str:
    bus = '[[bus]]\nname = "{0}"\ninterface = "socketcan"\nchannel = "{0}"\nbitrate = 250000\n\n'
    start, end = TEXT.index("[[bus]]"), TEXT.index("[[receiver]]")
    return TEXT[:start] + "".join(bus.format(name) for name in names) + TEXT[end:]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    out = tmp_path_factory.mktemp("socketcan")
    (out / "machine.toml").write_text(machine_text(*BUSES))
    (out / "drive.log").write_text(
        "".join(f"({1_700_000_000 + i * 0.002:.6f}) vcan0 18F11300#{i:016X}\n" for i in range(500))
    )
    with boot(["bash", "-e", "tests/vm/socketcan.sh"], out) as guest:
        guest.finish()
    return Drive(out)


def candump(path: Path) -> Iterator[tuple[int, int, bool, bool, bytes]]:
    """(receive stamp us, identifier, extended, error, data) of each line that is no remote frame."""
    for line in path.read_text().splitlines():
        found = _LINE.match(line)
        assert found, line
        seconds, micro, _, identifier, remote, data = found.groups()
        number = int(identifier, 16)
        if not remote:
            rx_us = int(seconds) * 1_000_000 + int(micro)
            error = len(identifier) == 8 and number & 0x2000_0000 != 0
            extended = len(identifier) == 8 and not error
            yield rx_us, number & 0x1FFF_FFFF, extended, error, bytes.fromhex(data)


@pytest.mark.parametrize(("bus", "least"), [("vcan0", 4500), ("can0", 500), ("can1", 400)])
def test_the_log_holds_what_candump_saw_frame_for_frame_stamp_for_stamp(
    drive: Drive, bus: str, least: int
) -> None:
    observed = list(candump(drive.out / f"{bus}.candump"))
    end_ns = float(drive.times["pulled"]) * 1e9 if bus == "can1" else float("inf")  # candump ends there
    logged = [frame for frame in drive.of(bus) if frame.rx_ns < end_ns]
    begin = len(observed) - len(logged)  # what candump saw before the daemon had opened the bus
    assert least < len(logged) <= len(observed)
    assert [row[1:] for row in observed[begin:]] == [(f.can_id, f.extended, f.error, f.data) for f in logged]
    apart_ns = [abs(f.rx_ns - row[0] * 1000) for f, row in zip(logged, observed[begin:], strict=True)]
    assert max(apart_ns) < 1500  # candump cuts at a microsecond
    assert {status.stamp for status in drive.buses(bus)} <= {"", "kernel"}


def test_a_real_controller_that_overruns_says_so(drive: Drive) -> None:
    """Two cards on one bus: what the second lost, 64 bytes of buffer in it, comes as error frames or not at
    all, and is never passed over."""
    sent = {f.data for f in drive.of("can0") if len(f.data) == 8}
    missing = len(sent - {f.data for f in drive.of("can1")})
    overruns = [f for f in drive.of("can1") if f.error and f.can_id & 0x4 and f.data[1] & 1]
    assert len(sent) == 500 and (missing == 0) == (overruns == [])
    assert any(e.text.startswith("can1: overrun") for e in drive.events) == bool(missing)


def test_error_frames_are_events_and_states(drive: Drive) -> None:
    messages = [e.text.partition(" (")[0] for e in drive.events if e.text.startswith("vcan0: ")]
    wanted = ("overrun", "error-passive", "bus-off", "the controller was restarted")
    received = [text for text in messages if text.startswith(tuple(f"vcan0: {word}" for word in wanted))]
    assert [next(word for word in wanted if word in text) for text in received] == list(wanted)
    statuses = drive.buses("vcan0")
    assert {"passive", "bus_off"} <= {status.controller for status in statuses}
    assert any("bus-off" in status.reason for status in statuses)
    last = statuses[-1]
    assert last.controller == "active" and "bus-off" not in last.reason and last.error_frames == 4
    counts = {count.reason: count.count for count in last.errors}
    assert counts == {"overrun": 1, "passive": 1, "bus_off": 1, "restarted": 1}


@pytest.mark.parametrize(
    ("begun", "done", "back", "bus", "text"),
    [
        ("down", "downed", "up", "vcan2", "Network is down; bring it up"),
        ("delete", "deleted", "back", "vcan2", "No such device; plug the adapter in"),
        ("pull", "pulled", "pulled", "can1", "Network is down; bring it up"),
    ],
)
def test_an_interface_that_goes_is_seen_said_and_shown(
    drive: Drive, begun: str, done: str, back: str, bus: str, text: str
) -> None:
    """A deleted one is down for an instant first, which only a reader that is quick enough hears of."""
    said_ns = drive.said(f"{bus}: socketcan {bus}: {text}", drive.done_ns(begun))
    done_ns = drive.done_ns(done)
    assert (said_ns - done_ns) * 1e-9 < 2.0 + drive.away_s(done_ns, max(said_ns, done_ns))
    assert (drive.said(f"{bus}: works again after", said_ns) - drive.done_ns(back)) * 1e-9 < 60.0
    if done != "pulled":  # for so long that a status was due
        assert any(one.state == "failed" and text in one.reason for one in drive.buses(bus))


@pytest.mark.parametrize(("bus", "failures"), [("vcan2", 2), ("can1", 1), ("vcan3", 0)])
def test_every_failure_is_an_event_and_a_count_in_every_later_status(
    drive: Drive, bus: str, failures: int
) -> None:
    """However soon it is over: can1 comes back at once."""
    messages = [e for e in drive.events if e.text.startswith(f"{bus}: socketcan") and "tried again" in e.text]
    begun = [min(e.t_ns for e in messages if f"(failure {n}, " in e.text) for n in range(1, failures + 1)]
    assert {e.text.partition("(failure ")[2].partition(",")[0] for e in messages} == set(
        map(str, range(1, failures + 1))
    )
    for status in drive.statuses:
        (one,) = (one for one in status.buses if one.name == bus)
        assert one.failures == sum(t_ns <= status.t_ns for t_ns in begun)
    assert drive.buses(bus)[-1].failures == failures and drive.buses(bus)[-1].state != "failed"


def test_what_waited_when_an_interface_went_is_in_the_log(drive: Drive) -> None:
    waited = [int.from_bytes(f.data, "little") for f in drive.of("vcan2") if f.can_id == 0x1F000010]
    assert waited == list(range(50))


def test_silence_is_seen_within_two_seconds(drive: Drive) -> None:
    silent_ns = drive.said("vcan1: silent", drive.done_ns("silent"))
    last_ns = max(f.t_ns for f in drive.of("vcan1") if f.t_ns < silent_ns)
    assert (silent_ns - last_ns) * 1e-9 < 2.0 + drive.away_s(last_ns, silent_ns)
    assert any(one.state == "silent" for one in drive.buses("vcan1"))


def test_what_the_kernel_could_not_keep_is_counted_exactly(drive: Drive) -> None:
    flood = [f for f in drive.of("vcan1") if f.can_id == 0x1FFFFF00]
    lost = drive.buses("vcan1")[-1].lost_frames
    assert int(drive.times["flood"]) == 20_000 == len(flood) + lost and 0 < lost < 15_000
    assert any(f"({lost} in all)" in e.text and "lost in the kernel" in e.text for e in drive.events)
    # Those kept came up to seconds late, and their stamps say when they really came.
    assert max(f.t_ns - f.rx_ns for f in flood) > 100_000_000


def test_the_other_bus_never_stopped(drive: Drive) -> None:
    frames = drive.of("vcan3")
    steady = [int.from_bytes(f.data, "little") for f in frames if f.can_id == 0x0ABCDEF0]
    assert steady == list(range(len(steady))) and len(steady) > 200
    assert len(frames) == int(drive.times["steady"])
    assert drive.buses("vcan3")[-1].lost_frames == 0
