"""What `tilth experiment` prompts, in Foxglove: a real prompter, the server, a viewer, the layouts."""

import json
import math
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest
import zenoh
from client_daemon import until
from foxglove_viewer import Viewer, viewer_at
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from paths import ROOT
from stage import SPEED, START_NS, Point, pose

from tilth.cli.foxglove import LAYOUTS
from tilth.client.experiment import prompter
from tilth.client.experiment.prompter import ARM, COUNTDOWN, IDLE, LINING_UP, RUNNING, course_of
from tilth.client.experiment.runner import PlanRunner
from tilth.client.experiment.wires import ENCODING, PrompterWires
from tilth.client.link import open_session
from tilth.estimator.models.parameters import TABLE_5_1
from tilth.schemas.channels import CHANNEL
from tilth.schemas.experiment import ExperimentPlan, parse_plan
from tilth.schemas.proto import tilth_pb2 as pb

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
from tilth.monitor.foxglove_prompt import prompt_of
from tilth.monitor.foxglove_server import SERVED, FoxgloveServer

BASE = "tilth/jd7930-parker500"
TOPIC = "/experiment"
POSE_S = 0.1
WHEEL = 0.03  # rad, whatever the way is
PLAN = parse_plan("""
name = "viewed"
machine = "jd7930-parker500"
[field]
length = 400
width = 80
[[run]]
kind = "chirp"
speed = 2.4
amplitude_deg = 8
seconds = 15
""")
PANELS: dict[str, tuple[str, dict[str, Any]]] = {
    f"{layout}: {name}": (name.partition("!")[0], panel)
    for layout in LAYOUTS
    for name, panel in json.loads((ROOT / "deploy" / layout).read_text())["configById"].items()
}
NUMBERS = {
    FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_ENUM, FieldDescriptor.CPPTYPE_UINT32,
}  # fmt: skip
TEXTS = {FieldDescriptor.CPPTYPE_STRING}


@contextmanager
def watching() -> Iterator[tuple[zenoh.Session, FoxgloveServer, Viewer]]:
    """A server that hears this session, and a viewer of the prompt."""
    with open_session("tcp/127.0.0.1:1") as ours, closing_server() as server:
        server.follow(ours, BASE)
        with viewer_at(f"ws://127.0.0.1:{server.port}") as viewer:
            viewer.hear_until(lambda: TOPIC in viewer.channels)
            viewer.subscribe(TOPIC)
            until(server._channels[TOPIC].has_sinks)  # it is said to nobody else
            yield ours, server, viewer


@contextmanager
def closing_server() -> Iterator[FoxgloveServer]:
    server = FoxgloveServer("127.0.0.1", 0)
    try:
        yield server
    finally:
        server.stop()


def say(ours: zenoh.Session, server: FoxgloveServer, message: pb.ExperimentState | pb.Status) -> None:
    """To the server, until it has taken it: what comes on two keys it may take in any order."""
    served = server.served
    prompt = isinstance(message, pb.ExperimentState)
    key, encoding = (TOPIC, ENCODING) if prompt else ("/status", CHANNEL["/status"].encoding)
    ours.put(f"{BASE}{key}", message.SerializeToString(), encoding=encoding)
    until(lambda: server.served > served)


def drive_on(
    ours: zenoh.Session, server: FoxgloveServer, runner: PlanRunner, turn: int
) -> pb.ExperimentState:
    """One pose more, straight on; what the prompter shows then, once the server has it: poses and prompts
    come on two keys, and by a pose 2 s ahead of the last prompt nobody prompts any more."""
    t_s = turn * POSE_S
    told = pose(START_NS + round(1e9 * t_s), Point(SPEED * t_s, 0.0, 0.0, 0.0, 0.0), "", wheel=WHEEL)
    ours.put(f"{BASE}/pose", CHANNEL["/pose"].encode(told), encoding=CHANNEL["/pose"].encoding)
    states: list[pb.ExperimentState] = []

    def taken() -> bool:
        states.append(runner.turn())
        return runner.prompt.track[-1:] != () and runner.prompt.track[-1].t_s >= told.t_ns * 1e-9

    until(taken)
    until(lambda: server._prompted_ns >= states[-1].t_ns)
    return states[-1]


def drive_into_a_run(
    ours: zenoh.Session, server: FoxgloveServer, runner: PlanRunner, into_s: float
) -> list[pb.ExperimentState]:
    """All that was shown with each pose, from the first one on."""
    states = [drive_on(ours, server, runner, 1)]
    runner.order(ARM)
    while states[-1].phase != RUNNING or states[-1].at_s < into_s:
        assert len(states) < 400, states[-1].text
        states.append(drive_on(ours, server, runner, len(states) + 1))
    return states


@pytest.fixture(scope="module")
def run() -> tuple[list[pb.ExperimentState], list[tuple[int, Any]], dict[str, Any], set[str]]:
    """What a prompter showed, what a viewer had (time, message), what the server says of itself, and the keys
    on which anything was said."""
    keys: set[str] = set()
    with watching() as (ours, server, viewer):
        said = ours.declare_subscriber("**", lambda sample: keys.add(str(sample.key_expr)))
        marks = ours.declare_queryable(f"{BASE}/mark", lambda query: query.reply(query.key_expr, b""))
        with closing(PrompterWires(ours, BASE)) as wires:
            states = drive_into_a_run(ours, server, PlanRunner(wires, course_of(PLAN, TABLE_5_1)), 3.0)
            last = states[-1].t_ns
            viewer.hear_until(lambda: viewer.heard[TOPIC][-1:] != [] and viewer.heard[TOPIC][-1][0] >= last)
            had = [
                (t_ns, one) for (t_ns, _), one in zip(viewer.heard[TOPIC], viewer.decoded(TOPIC), strict=True)
            ]
            said.undeclare()
            marks.undeclare()
        return states, had, viewer.info, keys


Run = tuple[list[pb.ExperimentState], list[tuple[int, Any]], dict[str, Any], set[str]]


def test_a_viewer_has_the_bar_in_degrees_at_the_time_of_the_poses(run: Run) -> None:
    states, had, _, _ = run
    prompts = {t_ns: one for t_ns, one in had}
    assert [t_ns for t_ns, _ in had] == sorted(one.t_ns for _, one in had)
    followed = [state for state in states if state.phase == RUNNING]
    assert len(followed) > 20
    for state in followed:
        one = prompts[state.t_ns]
        assert one.DESCRIPTOR.full_name == "tilth.ExperimentPrompt"
        assert (one.phase, one.text, one.drive, one.count) == (RUNNING, "Follow the bar.", state.drive, 0)
        assert one.wanted_deg == pytest.approx(math.degrees(state.wanted))
        assert one.measured_deg == pytest.approx(math.degrees(WHEEL))
        assert list(one.ahead_deg) == pytest.approx([math.degrees(angle) for angle in state.ahead])
        assert one.ahead_deg[0] == pytest.approx(one.wanted_deg)
        assert (one.left_end_deg, one.right_end_deg) == pytest.approx((-1.3 * 8, 1.3 * 8))
    wanted = [prompts[state.t_ns].wanted_deg for state in followed]
    assert max(wanted) - min(wanted) > 1.0  # it moves


def test_a_viewer_has_the_countdown_and_what_it_waits_for(run: Run) -> None:
    _, had, _, _ = run
    prompts = [one for _, one in had]
    phases = list(dict.fromkeys(one.phase for one in prompts))
    assert phases == [IDLE, LINING_UP, COUNTDOWN, RUNNING]
    counts = [one.count for one in prompts if one.phase == COUNTDOWN]
    assert list(dict.fromkeys(counts)) == [3, 2, 1]
    assert {one.count for one in prompts if one.phase != COUNTDOWN} == {0}
    assert {one.text for one in prompts if one.phase == LINING_UP} == {
        "Line up: drive straight at the speed shown."
    }
    waiting = next(one for one in prompts if one.phase == LINING_UP)
    assert {one.name for one in waiting.conditions} == {"receivers", "speed", "straight", "room"}
    assert not all(one.met for one in waiting.conditions)


def test_a_viewer_can_order_nothing(run: Run) -> None:
    _, _, info, keys = run
    assert info["capabilities"] == ["time"]  # neither clientPublish nor services nor parameters
    assert keys == {f"{BASE}/pose", f"{BASE}{TOPIC}"}  # and the server itself says nothing


def test_a_bar_that_nobody_moves_any_more_is_taken_away_once() -> None:
    with watching() as (ours, server, viewer):
        state = pb.ExperimentState(
            t_ns=START_NS, phase=RUNNING, text="Follow the bar.", wanted=0.1, measured=0.1, ahead=[0.1, 0.2]
        )
        say(ours, server, state)
        for after_ms in (1500, 2500, 3500):
            say(ours, server, pb.Status(t_ns=START_NS + after_ms * 1_000_000))
        state.t_ns, state.phase = START_NS + 4_000_000_000, IDLE
        say(ours, server, state)
        viewer.hear_until(lambda: len(viewer.heard[TOPIC]) == 3)
        running, gone, again = viewer.decoded(TOPIC)
    assert (running.phase, gone.phase, again.phase) == (RUNNING, "", IDLE)
    assert gone.t_ns == START_NS + 2_500_000_000 and "not heard" in gone.text
    assert math.isnan(gone.wanted_deg) and math.isnan(gone.measured_deg) and list(gone.ahead_deg) == []


def test_the_table_of_conditions_is_never_empty() -> None:
    """A viewer's table shows an error then."""
    following = prompt_of(pb.ExperimentState(phase="running"), 1)
    assert [(one.met, one.text) for one in following.conditions] == [(True, "it waits for nothing now")]
    waiting = prompt_of(pb.ExperimentState(conditions=[pb.ExperimentCondition(name="speed")]), 1)
    assert [one.name for one in waiting.conditions] == ["speed"]


def test_before_the_first_pose_a_prompt_has_the_daemons_time() -> None:
    with watching() as (ours, server, viewer):
        say(ours, server, pb.Status(t_ns=START_NS))
        say(ours, server, pb.ExperimentState(phase=IDLE, text="Arm it."))
        viewer.hear_until(lambda: len(viewer.heard[TOPIC]) == 1)
        assert [t_ns for t_ns, _ in viewer.heard[TOPIC]] == [START_NS]
        assert [one.text for one in viewer.decoded(TOPIC)] == ["Arm it."]


@pytest.mark.parametrize(
    ("data", "encoding", "why"),
    [
        (b"\xff\xff", ENCODING, "not an ExperimentState"),
        (b"x" * 100_000, ENCODING, "not an ExperimentState"),
        (pb.ExperimentState(t_ns=5).SerializeToString(), "text/plain", "not an ExperimentState"),
        (pb.ExperimentState(phase=IDLE).SerializeToString(), ENCODING, "without a time"),
        (pb.ExperimentState(t_ns=2**64 - 1).SerializeToString(), ENCODING, "without a time"),
    ],
)
def test_what_is_no_prompt_is_refused(data: bytes, encoding: str, why: str) -> None:
    with open_session("tcp/127.0.0.1:1") as ours, closing_server() as server:
        server.follow(ours, BASE)
        ours.put(f"{BASE}{TOPIC}", data, encoding=encoding)
        until(lambda: server.refused == {f"{TOPIC}: {why}": 1})
        assert server.served == 0


@pytest.mark.parametrize(
    ("count_s", "count"),
    [(3.0, 3), (2.01, 3), (0.01, 1), (0.0, 0), (-1.0, 0), (math.nan, 0), (math.inf, 0), (None, 0)],
)
def test_a_countdown_is_rounded_up(count_s: float | None, count: int) -> None:
    assert prompt_of(pb.ExperimentState(count_s=count_s), 1).count == count


@pytest.fixture(scope="module")
def schemas() -> dict[str, Descriptor]:
    """Topic -> schema, as a viewer is told them."""
    with closing_server() as server, viewer_at(f"ws://127.0.0.1:{server.port}") as viewer:
        viewer.hear_until(lambda: len(viewer.channels) == len(SERVED) + 1)
        return {topic: viewer.schema(topic) for topic in viewer.channels}


def field_of(schemas: dict[str, Descriptor], path: str) -> tuple[FieldDescriptor, bool]:
    """The field that a path ends in, and whether it is of many. Each array but the last needs a slice."""
    topic, *names = re.sub(r"\{[^}]*\}", "", path).split(".")
    at: Descriptor | None = schemas[topic]
    fields: list[FieldDescriptor] = []
    for k, name in enumerate(names):
        assert at is not None, path
        field = at.fields_by_name[name.removesuffix("[:]")]
        assert field.is_repeated or not name.endswith("[:]"), path
        assert not field.is_repeated or name.endswith("[:]") or k == len(names) - 1, path
        fields.append(field)
        at = field.message_type
    return fields[-1], any(field.is_repeated for field in fields)


def plot(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    assert panel["paths"]
    for series in panel["paths"]:
        field, many = field_of(schemas, series["value"])
        assert field.cpp_type in NUMBERS and series["enabled"]
        assert not many or "[:]" in series["value"]
        if series["value"].endswith("[:]"):  # all of an array: against its index, of the last message only
            assert panel["xAxisVal"] == "index"


def gauge(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    field, many = field_of(schemas, panel["path"])
    assert field.cpp_type in NUMBERS and not many and not field.has_presence
    assert panel["minValue"] == -panel["maxValue"] < 0 == panel["origin"]


def indicator(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    field, many = field_of(schemas, panel["path"])
    assert not many and not field.has_presence  # else it goes on showing what is not so any more
    for rule in panel["rules"]:
        assert rule["operator"] == "=" and rule["label"]
        assert field.cpp_type in TEXTS or (field.cpp_type in NUMBERS and rule["rawValue"].isdecimal())


def raw(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    field, many = field_of(schemas, panel["topicPath"])
    assert field.cpp_type in TEXTS and not many


def table(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    field, many = field_of(schemas, panel["topicPath"])
    assert many and field.message_type is not None


def scene(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    for topic in panel["topics"]:
        assert schemas[topic].full_name == "foxglove.SceneUpdate"


def chart(schemas: dict[str, Descriptor], panel: dict[str, Any]) -> None:
    for topic in (*panel["topicColors"], panel["followTopic"], *panel["disabledTopics"]):
        assert schemas[topic].full_name == "foxglove.LocationFix"


CHECKS = {
    "Plot": plot, "Gauge": gauge, "Indicator": indicator, "RawMessages": raw, "Table": table, "3D": scene,
    "map": chart,
}  # fmt: skip


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_shows_what_is_served(schemas: dict[str, Descriptor], name: str) -> None:
    kind, panel = PANELS[name]
    CHECKS[kind](schemas, panel)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_shows_all_of_its_panels(layout: str) -> None:
    def names(part: Any) -> list[str]:
        return [part] if isinstance(part, str) else names(part["first"]) + names(part["second"])

    told = json.loads((ROOT / "deploy" / layout).read_text())
    assert sorted(names(told["layout"])) == sorted(told["configById"])


def test_the_indicators_know_each_phase_and_each_second_that_a_plan_may_count() -> None:
    def values(name: str) -> list[str]:
        return [rule["rawValue"] for rule in PANELS[f"foxglove/experiment.json: {name}"][1]["rules"]]

    phases = (IDLE, LINING_UP, COUNTDOWN, RUNNING, prompter.NOTING, prompter.FINISHED)
    assert values("Indicator!phase") == [*phases]
    (most,) = (rule.le for rule in ExperimentPlan.model_fields["countdown_s"].metadata if hasattr(rule, "le"))
    assert values("Indicator!countdown") == [str(n) for n in range(1, most + 1)]


def test_the_plots_of_the_bar_show_wanted_and_actual_on_one_axis() -> None:
    ahead, followed = (PANELS[f"foxglove/experiment.json: Plot!{name}"][1] for name in ("bar", "followed"))
    assert [series["value"] for series in ahead["paths"]][:2] == [
        "/experiment.ahead_deg[:]", "/experiment.measured_deg",
    ]  # fmt: skip
    assert [series["value"] for series in followed["paths"]][:2] == [
        "/experiment.wanted_deg", "/experiment.measured_deg",
    ]  # fmt: skip
    assert followed["xAxisVal"] == "timestamp" and followed["followingViewWidth"] > 0
