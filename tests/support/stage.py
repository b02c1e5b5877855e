"""A daemon as the page hears it: the daemon's own Zenoh sink in a process of its own, with a drive that is
made up and obeys orders. What only a real daemon can show is tested with one; see test_page.py.

    python tests/support/stage.py PORT [RATE]      orders are JSON lines on stdin; it ends when that is closed
"""

import json
import math
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import zenoh
from client_daemon import text_on
from loopback import PATIENCE_S
from ordered import Ordered, ready, take_orders
from websockets.sync.client import ClientConnection, connect

from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import (
    PARAMETERS,
    BodyPose,
    Estimate,
    Event,
    ParameterEstimate,
    Pose,
    Status,
    known_flags,
)
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason, text_reason

START_NS = 1_790_000_000_000_000_000
TRUTH = (215e3, 470e3, 150e3, 0.9, 1.2, 0.8)
SPEED = 2.4  # m/s
ROW_M, APART_M = 90.0, 9.0
HITCH_M, DRAWBAR_M, TO_CG_M = 2.1, 3.72, 3.62
MOUNTS = ("tractor_front", "tractor_rear", "implement_front", "implement_rear")
ORDERS: dict[str, Any] = {
    "scale": 1.0, "lost": "", "recording": True, "event": "", "text": "", "version": "", "silent": False,
    "problem": "", "refusal": "", "preparing": "", "ready_in_s": None, "invalid": "", "flag": "", "moved": [],
    "implements": [], "load": None,
    "run": "20261121T080000Z", "log_file": "", "wheel": None, "ahead_s": 0.0,
}  # fmt: skip


class Point(NamedTuple):
    north: float
    east: float
    heading: float
    yaw_rate: float
    implement_heading: float


def drive(period_s: float) -> Iterator[Point]:
    """Up and down the rows, for ever: straight, half a circle, straight."""
    north = east = heading = behind = 0.0
    turn_s, row_s = math.pi * APART_M / 2 / SPEED, ROW_M / SPEED
    side, t = 1, 0.0
    while True:
        turning = t % (row_s + turn_s) > row_s
        yaw_rate = side * math.pi / turn_s if turning else 0.0
        heading += yaw_rate * period_s
        north += SPEED * math.cos(heading) * period_s
        east += SPEED * math.sin(heading) * period_s
        behind += (SPEED * math.sin(heading - behind) - HITCH_M * yaw_rate) / DRAWBAR_M * period_s
        if (t + period_s) // (row_s + turn_s) > t // (row_s + turn_s):
            side = -side
            heading = round(heading / math.pi) * math.pi
        t += period_s
        yield Point(north, east, heading, yaw_rate, behind)


def pose(t_ns: int, at: Point, lost: str, flag: str = "", wheel: float | None = None) -> Pose:
    """wheel: what its angle is, rad, whatever the way is."""
    hitch = (at.north - HITCH_M * math.cos(at.heading), at.east - HITCH_M * math.sin(at.heading))
    back = (math.cos(at.implement_heading), math.sin(at.implement_heading))
    cart = (hitch[0] - TO_CG_M * back[0], hitch[1] - TO_CG_M * back[1])
    tractor = _body(at.north, at.east, at.heading, at.yaw_rate)
    implement = _body(*cart, at.implement_heading, at.yaw_rate)
    flags = (*((f"lost:{lost}",) if lost else ()), *((flag,) if flag else ()))
    articulation = at.heading - at.implement_heading
    if wheel is None:
        wheel = math.atan(at.yaw_rate * 2.9 / SPEED)
    return Pose(
        t_ns, 43.5, -83.4, tractor, implement, articulation, 0.003, wheel, 0.002, 1, None, 0.01,
        4 - bool(lost), known_flags(flags),
    )  # fmt: skip


def _body(north: float, east: float, heading: float, yaw_rate: float) -> BodyPose:
    return BodyPose(
        north, east, 0.01, heading, 0.003, SPEED, 0.02, 0.02, 0.03, yaw_rate, 0.002, 0.01, 0.005
    )  # fmt: skip


def estimate(t_ns: int, t_s: float, scale: float, since_s: float, invalid: str = "") -> Estimate:
    """All but sigma_r, sharpening from the prior; after a change, wide again. invalid: why nothing holds."""
    if invalid:
        none = tuple(ParameterEstimate(None, None, Status.INVALID, text_reason(invalid)) for _ in PARAMETERS)
        return Estimate(t_ns, "recommended", "relaxation", none, (), (None,) * 3)
    log_sd = [max(0.05 + 0.02 * i, 0.6 * math.exp(-since_s / 25.0)) for i in range(6)]
    covariance = [0.0] * 36
    covariance[::7] = [sd * sd for sd in log_sd]
    rows = []
    for i, (name, truth) in enumerate(zip(PARAMETERS, TRUTH, strict=True)):
        if name == "sigma_r" or since_s < 3 + 2 * i:
            why = Reason(Code.WIDE, numbers=(log_sd[i],))
            rows.append(ParameterEstimate(None, None, Status.UNESTIMATED, why))
            continue
        value = (
            truth
            * (scale if name.startswith("C_") else 1.0)
            * math.exp(0.4 * log_sd[i] * math.sin(t_s / 9 + i))
        )
        rows.append(ParameterEstimate(value, value * log_sd[i], Status.ESTIMATED, None, 0.4))
    return Estimate(
        t_ns, "recommended", "relaxation", tuple(rows), tuple(covariance), (None,) * 3, rank=5,
        rule=Reason(Code.FIRST_WITH_NUMBERS, ("pem", "pem", "tracker")),
        determined=tuple(Combination(tuple(float(j == k) for j in range(6)), log_sd[k]) for k in range(4)),
        bound=(*log_sd[:4], math.inf, log_sd[5]),
        advice=Advice(AdviceKind.MANOEUVRE, ("sigma_r",), (0.6,), False, 0.0, "chirp", 10.0, 5.0, (0.06,)),
    )  # fmt: skip


def status(t_ns: int, uptime_s: float, orders: dict[str, Any]) -> pb.Status:
    result = pb.Status(
        t_ns=t_ns, run=orders["run"], log_file=orders["log_file"],
        version=orders["version"] or _version(), uptime_s=uptime_s,
        frames=int(800 * uptime_s), poses=int(5 * uptime_s), recording=orders["recording"],
        log_bytes=int(40_000 * uptime_s), disk_free_bytes=4.2e9, hours_left=29.0,
    )  # fmt: skip
    result.preparing = orders.get("preparing", "")
    if orders.get("ready_in_s") is not None:
        result.ready_in_s = orders["ready_in_s"]
    if orders["implements"]:  # the first is hitched on
        result.implement = orders["implements"][0]
        result.implements.extend(sorted(orders["implements"]))
    if orders["load"] is not None:  # what it carries, kg; below zero: nobody has said it
        result.full_load, result.load.mass = 6000.0, orders["load"]
        result.load.source, result.load.sd = "nobody" if orders["load"] < 0 else "operator", 300.0
    if orders["moved"]:
        result.moved.add(names=orders["moved"], text=f"{orders['moved'][0]} has been moved 0.10 m forward")
    result.buses.add(name="can0", state="open", frames_per_s=800.0, load=0.45)
    for mount in MOUNTS:
        lost = mount == orders["lost"]
        row = result.receivers.add(mount=mount, state="lost" if lost else "alive", age_s=4.0 if lost else 0.1)
        row.fix, row.per_s = ("", 0.0) if lost else ("rtk_fixed", 5.0)
        if lost:
            row.fault, row.fault_age_s = "lost", 0.0
    result.wheel_angle.state, result.wheel_angle.age_s, result.wheel_angle.per_s = "alive", 0.01, 100.0
    result.problems.extend([orders["problem"]] if orders["problem"] else [])
    if orders["lost"]:
        result.problems.append(f"{orders['lost'].replace('_', ' ')}: no longer heard; check power and plug")
    return result


def _version() -> str:
    from tilth.monitor.view import installed_version

    return installed_version()


class Stage(Ordered):
    """The process."""

    def __init__(self, port: int | None = None, rate: float = 1.0, **orders: Any) -> None:
        """rate: of its time to that of the world; its poses come ten times a second of the world's. orders:
        as it begins."""
        super().__init__(__file__, port, str(rate), json.dumps(orders))


class Monitor:
    """`tilth monitor` as a person runs it."""

    def __init__(self, *words: str, port: int = 0, stderr: int | None = None) -> None:
        start = [sys.executable, "-c", "import sys; from tilth.cli import main; sys.exit(main())"]
        self.process = subprocess.Popen(
            [*start, "monitor", "--port", str(port), *words],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self.address = self.url.removeprefix("http://").rstrip("/")

    def close(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=PATIENCE_S)
        assert self.process.returncode == 0

    def live(self, **options: Any) -> ClientConnection:
        return cast(ClientConnection, connect(f"ws://{self.address}/live", max_size=None, **options))

    def ask(self, path: str, data: bytes | None = None, **headers: str) -> tuple[int, str, dict[str, str]]:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        request = urllib.request.Request(f"{self.url.rstrip('/')}{path}", data, named)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
                return answer.status, answer.read().decode(), dict(answer.headers)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read().decode(), dict(error.headers)

    def mark(self, text: Any, **headers: str) -> dict[str, Any]:
        headers = {"content_type": "application/json"} | headers
        return cast(
            dict[str, Any], json.loads(self.ask("/mark", json.dumps({"text": text}).encode(), **headers)[1])
        )


def main() -> None:
    port, rate = int(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 1.0
    orders = ORDERS | json.loads(sys.argv[3] if len(sys.argv) > 3 else "{}")
    noted: deque[str] = deque()

    def mark(query: zenoh.Query, client: str) -> None:
        if "*" in str(query.key_expr):
            return
        if orders["refusal"]:
            query.reply_err(orders["refusal"])
            return
        assert query.payload is not None
        noted.append(query.payload.to_string())
        query.reply(query.key_expr, b"")

    def accept(query: zenoh.Query, client: str) -> None:
        name = query.payload.to_string() if query.payload is not None else ""
        if name not in orders["moved"]:
            query.reply_err(f"{name} has not been found moved")
            return
        orders["moved"] = []
        query.reply(query.key_expr, b"")

    def implement(query: zenoh.Query, client: str) -> None:
        name = query.payload.to_string() if query.payload is not None else ""
        if name not in orders["implements"][:2]:
            query.reply_err(f"no implement {name}")
            return
        orders["implements"] = sorted(orders["implements"], key=lambda one: one != name)
        query.reply(query.key_expr, b"")

    def load(query: zenoh.Query, client: str) -> None:
        said = query.payload.to_string() if query.payload is not None else ""
        orders["load"] = {"full": 6000.0, "empty": 0.0}[said]
        query.reply(query.key_expr, b"")

    answers = {"mark": mark, "accept": accept, "implement": implement, "load": load}
    sink = ZenohSink(parse_machine(text_on(port)), "replay", answers=answers)
    ended = take_orders(orders)
    ready()
    every_s, scale, changed_s, points = 0.1 * rate, 1.0, 0.0, drive(0.1)
    turn, began_s = 0, time.monotonic()
    while not ended.wait(max(0.0, began_s + 0.1 * turn - time.monotonic())):
        turn += 1
        t_s = turn * every_s
        t_ns = START_NS + int(1e9 * (t_s + orders["ahead_s"]))
        at = next(points)
        if orders["silent"]:
            continue
        told = pose(t_ns, at, orders["lost"], orders["flag"], orders["wheel"])
        sink.put("/pose", CHANNEL["/pose"].encode(told))
        if orders["scale"] != scale:
            scale, changed_s = orders["scale"], t_s
            orders["event"], orders["text"] = "soil_change", "the soil holds the tyres otherwise since here"
        while noted:
            sink.put("/event", CHANNEL["/event"].encode(Event(t_ns, "mark", in_words(noted.popleft()))))
        if orders["event"]:
            kind, orders["event"] = orders["event"], ""
            sink.put("/event", CHANNEL["/event"].encode(Event(t_ns, kind, in_words(orders["text"]))))
        if turn % 10 == 0 or rate > 1:
            result = estimate(t_ns, t_s, scale, t_s - changed_s, orders["invalid"])
            sink.put("/soil_tire", CHANNEL["/soil_tire"].encode(result))
            sink.put("/status", CHANNEL["/status"].encode(status(t_ns, t_s, orders)))
    sink.close()


if __name__ == "__main__":
    main()
