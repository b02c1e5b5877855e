"""Receivers that send each position again, or seldom, are named once; what repeats is left out."""

from dataclasses import replace

import pytest
from circle import Circle, demo_machine

from tilth.estimator.pose import aligner
from tilth.schemas.flow import Measurement, Mount, Position
from tilth.schemas.notices import Notice
from tilth.schemas.sentences import notice_sentence

FRONT = Mount.IMPLEMENT_FRONT
COPY_NS = 100_000_000


def news(measurements: list[Measurement]) -> tuple[list[tuple[str, Notice]], aligner.Aligner]:
    state = aligner.initial(demo_machine())
    out = []
    for measurement in sorted(measurements, key=lambda m: m.rx_ns):
        aligner.take(state, measurement)
        out += aligner.news(state)
    return out, state


def again(measurement: Measurement) -> Measurement:
    later = replace(measurement, t_ns=measurement.t_ns + COPY_NS, rx_ns=measurement.rx_ns + COPY_NS)
    return replace(later, repeat=True) if isinstance(later, Position) else later


def test_who_sends_each_position_twice_is_named_and_the_copies_are_left_out() -> None:
    given = list(Circle().measurements(20.0))
    copies = [again(m) for m in given if m.origin.mount is FRONT]
    out, state = news(given + copies)
    assert [kind for kind, _ in out] == ["positions_repeated"]
    assert notice_sentence(out[0][1]).startswith(
        "implement_front sends each position 2 times: 5.0 a second are new"
    )
    _, alone = news(given)
    track, clean = state.tracks[FRONT.value], alone.tracks[FRONT.value]
    assert len({t for t, *_ in track.positions}) == len(track.positions)
    for name in ("velocities", "yaw_rates"):
        one, other = list(getattr(track, name)), list(getattr(clean, name))
        assert [row[1:] for row in one[-10:]] == [row[1:] for row in other[-10:]]


@pytest.mark.parametrize(("period_s", "kinds"), [(1.0, ["positions_slow"]), (0.2, []), (0.5, [])])
def test_one_position_a_second_is_said(period_s: float, kinds: list[str]) -> None:
    circle = Circle(period_s={FRONT: period_s})
    out, _ = news(list(circle.measurements(90.0)))
    assert [kind for kind, _ in out] == kinds
    if kinds:
        assert (
            notice_sentence(out[0][1])
            == "implement_front gives only 1.0 positions a second; set it to 5 or more"
        )


def test_a_receiver_at_rest_may_repeat_itself() -> None:
    given = [m for m in Circle(speed=0.0, yaw_rate=0.0, lateral_velocity=0.0).measurements(30.0)]
    out, _ = news(given + [again(m) for m in given if m.origin.mount is FRONT])
    assert out == []
