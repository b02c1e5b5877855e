"""A prompter on a real network: poses and orders come in, marks and what is shown go out, answers return."""

import json
from collections.abc import Iterator
from contextlib import closing

import pytest
import zenoh
from client_daemon import until
from loopback import PATIENCE_S
from stage import Stage

from tilth.client.experiment.prompter import COUNTDOWN, IDLE, LINING_UP, Marked, course_of
from tilth.client.experiment.runner import JUMPED, RESTARTED, PlanRunner
from tilth.client.experiment.wires import PrompterWires
from tilth.client.link import open_session
from tilth.estimator.models.parameters import TABLE_5_1
from tilth.schemas.experiment import parse_plan
from tilth.schemas.proto import tilth_pb2 as pb

BASE = "tilth/jd7930-parker500/replay"
PLAN = parse_plan("""
name = "wired"
machine = "jd7930-parker500"
[field]
length = 300
width = 60
[[run]]
kind = "steps"
speed = 2.4
amplitude_deg = 5
seconds = 10
""")


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    with Stage() as one:
        yield one


@pytest.fixture
def wires(stage: Stage) -> Iterator[PrompterWires]:
    with closing(PrompterWires(client(stage), BASE)) as one:
        yield one


def client(stage: Stage) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("scouting/multicast/enabled", False),
        ("connect/endpoints", [stage.endpoint]),
        ("connect/timeout_ms", 10_000),
    ):
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def order(page: zenoh.Session, payload: bytes) -> str:
    """What the prompter answers: "" where it took it."""
    for reply in page.get(f"{BASE}/experiment/order", payload=payload, timeout=PATIENCE_S):
        return "" if reply.ok is not None else reply.err.payload.to_string() if reply.err else "?"
    return "silence"


def test_a_mark_is_answered_or_refused_in_the_daemons_words(wires: PrompterWires, stage: Stage) -> None:
    assert wires.mark_now("one start").refusal == ""
    wires.mark("another start")
    answers: list[Marked] = []

    def answered() -> bool:
        answers.extend(wires.answers())
        return bool(answers)

    until(answered)
    assert [(one.text, one.refusal) for one in answers] == [("another start", "")]
    stage.order(refusal="the disk is full")
    until(lambda: wires.mark_now("a third").refusal == "the disk is full")
    stage.order(refusal="")


def test_the_page_sees_where_it_stands_and_its_orders_arrive(wires: PrompterWires, stage: Stage) -> None:
    runner = PlanRunner(wires, course_of(PLAN, TABLE_5_1))
    with open_session(stage.endpoint) as page:
        seen: list[pb.ExperimentState] = []
        subscriber = page.declare_subscriber(
            f"{BASE}/experiment", lambda s: seen.append(pb.ExperimentState.FromString(s.payload.to_bytes()))
        )
        until(lambda: runner.turn().HasField("measured") and bool(seen) and seen[-1].HasField("measured"))
        assert (seen[-1].phase, seen[-1].plan, seen[-1].of) == (IDLE, "wired", 3)
        assert {one.name for one in seen[-1].conditions} == {"receivers", "speed", "straight", "room"}
        assert order(page, pb.ExperimentOrder(kind="dance").SerializeToString()).startswith(
            "'dance': no order"
        )
        assert "ExperimentOrder" in order(page, b"\xff\xff")
        assert order(page, pb.ExperimentOrder(kind="arm").SerializeToString()) == ""
        until(lambda: runner.turn().phase in (LINING_UP, COUNTDOWN))
        runner.order("stop")
        assert runner.turn().phase == IDLE
        subscriber.undeclare()


def test_poses_of_an_earlier_clock_and_of_another_run_are_followed(
    wires: PrompterWires, stage: Stage
) -> None:
    runner = PlanRunner(wires, course_of(PLAN, TABLE_5_1))

    def well() -> bool:
        return any(one.name == "receivers" and one.met for one in runner.turn().conditions)

    stage.order(log_file="/logs/one.mcap")
    until(lambda: well() and bool(wires.logs))  # a status was heard: which run it is, is known
    for change, why in (({"ahead_s": -3600.0}, JUMPED), ({"run": "another"}, RESTARTED)):
        now_s = runner.prompt.now_s
        stage.order(**change)
        until(lambda why=why: why in runner.turn().text.lower())  # type: ignore[misc]
        until(well)
        assert (runner.prompt.now_s < now_s) == (why == JUMPED)


def test_of_two_that_begin_at_once_one_gives_way(wires: PrompterWires, stage: Stage) -> None:
    course = course_of(PLAN, TABLE_5_1)
    with closing(PrompterWires(client(stage), BASE)) as other:
        runners = [PlanRunner(one, course) for one in (wires, other)]
        until(lambda: bool([r.turn() for r in runners]) and bool(wires.gives_way_to or other.gives_way_to))
        for runner in runners * 20:
            runner.turn()
        assert sorted((wires.gives_way_to, other.gives_way_to)) == ["", "wired"]


def test_nothing_is_armed_while_the_daemon_is_silent(
    wires: PrompterWires, stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tilth.client.experiment.runner.UNHEARD_S", 2.5)  # as in five seconds
    runner = PlanRunner(wires, course_of(PLAN, TABLE_5_1))
    until(lambda: runner.turn().HasField("measured") and wires.silent_s > 0.0)  # both were heard
    stage.order(silent=True)
    until(lambda: "is it still running?" in runner.turn().text)
    runner.order("arm")
    assert runner.turn().phase == IDLE
    stage.order(silent=False)
    until(lambda: "is it still running?" not in runner.turn().text)
    runner.order("arm")
    assert runner.turn().phase != IDLE
