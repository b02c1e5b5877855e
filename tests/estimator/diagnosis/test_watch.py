"""What is moved is named, how far, and nothing else is; what is put back or accepted is over."""

import math
from dataclasses import replace

import numpy as np
import pytest
from circle import START_NS, Circle, demo_machine
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.diagnosis import watch
from tilth.estimator.diagnosis.accepted import acceptance, corrected, line_of
from tilth.estimator.diagnosis.hypotheses import Explanation, hypotheses, judge, posterior
from tilth.estimator.diagnosis.information import AT, KINDS, InformationForm, N, drift, lengths, rows
from tilth.estimator.diagnosis.sample import BodySample, Sample, sample
from tilth.estimator.diagnosis.watch import WATCH, WatchState
from tilth.estimator.pose import aligner
from tilth.estimator.record.record import KIND, NORTH, PLACE, VELOCITY
from tilth.estimator.rig.numbers import DRAWBAR, HYPOTHESES, HYPOTHESIS, PAIRS, WHEEL
from tilth.estimator.snapshot import restore, snapshot
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.flow import Accepted, Mount, Pose
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.traffic import simulate

Array = NDArray[np.float64]

LATENCIES = [row.name for row in HYPOTHESES if row.absorbed]
MACHINE = demo_machine()
RIG = lengths(MACHINE)
AMOUNTS = {mount.value: (0.1, 0.05) for mount in Mount} | {
    PAIRS[0]: (0.02,), PAIRS[1]: (-0.02,), WHEEL: (0.0175,), DRAWBAR: (0.12,),
    **dict.fromkeys(LATENCIES, (0.05,)),
}  # fmt: skip
SAID = [name for name in AMOUNTS if name not in LATENCIES]
BEFORE, AFTER = 12, 16  # blocks


class Drive:
    """Rows and turns, in which all measurements are what the constants say, and noise."""

    def __init__(self, seed: int = 1) -> None:
        self.state = WatchState()
        self._rng = np.random.default_rng(seed)
        self._poses = 0
        self.constants = self._rng.normal(0.0, 0.02, N)
        self.constants[AT["latency_tractor_front"] : AT["latency_implement_rear"] + 1] = (
            0.03,
            -0.04,
            0.0,
            0.05,
        )

    def move(self, name: str, amounts: tuple[float, ...]) -> None:
        self.constants = self.constants + watch.directions_of(MACHINE, name) @ np.array(amounts)

    def drive(self, blocks: int) -> list[Diagnosis]:
        found = []
        for _ in range(blocks * WATCH.block):
            self._poses += 1
            kinds, design, _ = rows(RIG, self._now())
            noise = self._rng.normal(0.0, RIG.sds[kinds])
            measured = design @ self.constants + noise
            watch._add(self.state, MACHINE, (kinds, design, measured), START_NS + self._poses * 200_000_000)
            if self.state.samples == WATCH.block:
                watch._end_block(self.state, MACHINE)
                found += watch._look(self.state, MACHINE)
        return found

    def _now(self) -> Sample:
        """A turn of 20 s after each row of 80 s, at half of the speed."""
        t_s = self._poses * 0.2
        turns = t_s % 100.0 > 80.0
        u, r = (1.9, 0.3) if turns else (3.5 + 0.5 * np.sin(t_s / 40.0), self._rng.normal(0.0, 0.02))
        articulation = 0.5 * np.sin((t_s % 100.0 - 80.0) / 20.0 * np.pi) if turns else 0.0
        roll = 0.02 * np.sin(t_s / 7.0)
        body = BodySample(0.0, 0.0, float(u), 0.0, float(r), float(roll), (0.0, 0.0))
        return Sample(replace(body, heading=float(articulation)), body, (0.0, 0.0), 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_found_where_nothing_was_moved(seed: int) -> None:
    assert Drive(seed).drive(40) == []


@pytest.mark.parametrize("name", SAID)
def test_what_is_moved_is_named_with_how_far(name: str) -> None:
    drive = Drive()
    assert drive.drive(BEFORE) == []
    drive.move(name, AMOUNTS[name])
    first, *_ = found = drive.drive(AFTER)
    assert name in first.of and {one.since_ns for one in found} == {first.since_ns}
    for one in (first, found[-1]):  # later ones only tell which
        if one.of[0] == name:
            off = np.array(one.amounts) - np.array(AMOUNTS[name])
            assert np.all(np.abs(off) < 4.0 * np.array(one.sds))
    assert abs(first.since_ns - START_NS - BEFORE * WATCH.block * 200_000_000) < 3 * WATCH.block * 200_000_000


@pytest.mark.parametrize("name", LATENCIES)
def test_a_latency_is_the_poses_own_business(name: str) -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move(name, AMOUNTS[name])
    assert drive.drive(AFTER) == []
    assert drive.state.moved == []


@pytest.mark.parametrize(("other", "absorbed"), [(80.0, False), (30.0, True)])
def test_what_may_as_well_be_a_receiver_is_not_taken_for_a_latency(other: float, absorbed: bool) -> None:
    """At one speed a receiver that is further forward looks like another latency."""
    drive = Drive()
    drive.drive(BEFORE)
    late = Explanation(LATENCIES[0], 100.0, np.array([0.03]), 1e-6 * np.eye(1))
    moved = Explanation("tractor_front", other, np.array([0.1, 0.0]), 1e-4 * np.eye(2))
    assert watch._found(drive.state, MACHINE, 3, [late, moved]) == []
    assert len(drive.state.blocks) == (3 if absorbed else BEFORE)


def test_a_look_is_above_x_with_a_chance_of_exp_minus_x_at_most() -> None:
    """While nothing is moved, of every suspect: the threshold follows from that."""
    rng, drive = np.random.default_rng(4), Drive()
    drive.drive(BEFORE)
    (mean, covariance), block = posterior(watch._sum(drive.state.blocks[:-2])), drive.state.blocks[-1]
    spread = np.linalg.cholesky(covariance + drift())
    values, vectors = np.linalg.eigh(block.information)
    noise = vectors * np.sqrt(np.maximum(values, 0.0))
    looks, above = 600, dict.fromkeys(AMOUNTS, np.zeros(3))
    for _ in range(looks):
        vector = block.information @ (mean + spread @ rng.normal(size=N)) + noise @ rng.normal(size=N)
        for one in judge(MACHINE, mean, covariance, InformationForm(block.information, vector)):
            above[one.name] = above[one.name] + (one.log_ratio > np.arange(1.0, 4.0))
    for share in above.values():
        chance = np.exp(-np.arange(1.0, 4.0))
        assert np.all(share / looks < chance + 4.0 * np.sqrt(chance / looks))


def test_the_threshold_is_of_the_looks_between_two_false_alarms() -> None:
    looks = 1000.0 * 3600.0 / 20.0 * len(WATCH.since)
    assert looks * math.exp(-watch.threshold()) == pytest.approx(1.0)


def test_what_is_too_small_to_matter_is_not_said() -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move("tractor_front", (0.015, 0.0))
    assert drive.drive(30) == []


def test_what_is_put_back_is_over() -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move("tractor_rear", (0.1, 0.0))
    drive.drive(AFTER)
    assert watch.left_out(drive.state) == {"tractor_rear"}
    drive.move("tractor_rear", (-0.1, 0.0))
    (over,) = drive.drive(AFTER)
    assert (
        over.state is DiagnosisState.CLEARED
        and drive.state.moved == []
        and watch.left_out(drive.state) == frozenset()
    )


def in_a_new_run(before: Drive, back: bool) -> Drive:
    """What has been found moved goes on in another run, in which it may be back in its place."""
    after = Drive(seed=2)
    after.constants = before.constants
    after.state.moved = [watch.carried(MACHINE, moved) for moved in before.state.moved]
    if back:
        for moved in before.state.moved:
            after.move(moved.names[0], tuple(-np.array(AMOUNTS[moved.names[0]])))
    return after


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("name", ["tractor_rear", WHEEL])
def test_what_an_earlier_run_found_stands_until_it_is_seen_in_its_place(name: str, back: bool) -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move(name, AMOUNTS[name])
    drive.drive(AFTER)
    assert [moved.names for moved in drive.state.moved] == [[name]]
    again = in_a_new_run(drive, back)
    told = again.drive(AFTER)
    assert [found.state for found in told] == ([DiagnosisState.CLEARED] if back else [])
    assert [moved.names for moved in again.state.moved] == ([] if back else [[name]])
    if not back:
        now = watch.proposal(again.state, MACHINE, name, START_NS)
        assert now is not None and now.amounts == pytest.approx(AMOUNTS[name], abs=0.03)


def test_what_another_version_found_is_not_taken() -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move(WHEEL, AMOUNTS[WHEEL])
    drive.drive(AFTER)
    (moved,) = drive.state.moved
    with pytest.raises(ValueError, match="wheel_angle is of another version"):
        watch.carried(MACHINE, replace(moved, covariance=np.eye(2)))


def test_two_things_moved_one_after_the_other_are_both_named() -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move("implement_rear", (-0.1, 0.0))
    drive.drive(AFTER)
    drive.move(WHEEL, (-0.02,))
    drive.drive(AFTER)
    assert [moved.names for moved in drive.state.moved] == [["implement_rear"], [WHEEL]]
    assert drive.state.moved[0].amounts == pytest.approx([-0.1, 0.0], abs=0.03)
    assert [one.key for one in watch.contradictions(drive.state)] == ["wheel_angle.zero"]


def test_what_is_accepted_is_measured_against_from_then_on() -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move("implement_front", (0.0, 0.1))
    drive.drive(AFTER)
    accepted = watch.proposal(drive.state, MACHINE, "implement_front", 7)
    assert accepted is not None and accepted.amounts == pytest.approx((0.0, 0.1), abs=0.03)
    watch.accept(drive.state, MACHINE, accepted)
    drive.move("implement_front", tuple(-amount for amount in accepted.amounts))  # as the new file is
    assert drive.drive(30) == [] and drive.state.moved == []
    assert watch.proposal(drive.state, MACHINE, "implement_front", 8) is None


@pytest.mark.parametrize(
    ("name", "amounts"),
    [
        *((mount.value, amounts) for mount in Mount for amounts in ((0.02, 0.0), (0.0, 0.02))),
        *((pair, (0.01,)) for pair in PAIRS),
        (DRAWBAR, (0.02,)),
    ],
)
def test_what_is_moved_changes_measurements_as_its_directions_say(
    name: str, amounts: tuple[float, ...]
) -> None:
    """Of a rig on a circle, whose receivers stand elsewhere than its file says."""
    elsewhere = corrected(MACHINE, [Accepted(0, name, amounts, (0.0,) * len(amounts))])
    readings = []
    for true in (MACHINE, elsewhere):
        state = aligner.initial(MACHINE)
        for measurement in Circle(true, yaw_rate=0.05, lateral_velocity=0.0).measurements(4.0):
            aligner.take(state, measurement)
        found = sample(state, START_NS + 2_000_000_000)
        assert found is not None
        readings.append(rows(RIG, found))
    (kinds, design, before), (_, _, after) = readings
    assert list(kinds) == list(range(KINDS))
    moved = next(hypothesis for hypothesis in hypotheses(MACHINE) if hypothesis.name == name)
    assert after - before == pytest.approx(design @ moved.directions @ np.array(amounts), abs=0.0005)


def test_it_watches_four_receivers_only() -> None:
    circle = Circle()
    state = aligner.initial(MACHINE)
    for measurement in circle.measurements(4.0, absent=frozenset({Mount.IMPLEMENT_REAR})):
        aligner.take(state, measurement)
    assert sample(state, START_NS + 2_000_000_000) is None
    three = MACHINE.model_copy(update={"receiver": MACHINE.receiver[:3]})
    assert sample(aligner.initial(three), START_NS) is None


def test_a_receiver_that_is_left_out_gives_neither_poses_nor_rows() -> None:
    state = fold.initial(MACHINE)
    state.ready = False
    poses, places = [], set[float]()
    for number, frame in enumerate(simulate(MACHINE, 12, 4.5)):
        if number == 0:
            aligner.leave_out(state.aligner, {"implement_front"})
        poses += [p.value for p in fold.step(state, frame) if isinstance(p.value, Pose)]
        for segment in state.segments:
            if segment is not None and not segment.reason:
                rows_of = segment.record.rows
                places |= set(rows_of[(rows_of[:, KIND] == NORTH) | (rows_of[:, KIND] == VELOCITY), PLACE])
    flags = {str(flag) for flag in poses[-1].flags}
    assert {"left_out:implement_front", "heading_by_hitch:implement"} <= flags
    assert poses[-1].receivers == 3 and poses[-1].implement.heading is not None
    assert places == {0.0, 1.0, 3.0}


def test_its_state_is_data() -> None:
    drive = Drive()
    drive.drive(BEFORE)
    drive.move("tractor_front", (0.1, 0.0))
    drive.drive(AFTER)
    state = fold.initial(MACHINE)
    state.diagnosis.watch = drive.state
    text = snapshot(state)
    assert snapshot(restore(MACHINE, text)) == text


@pytest.mark.parametrize("name", SAID)
def test_a_value_in_place_of_the_machine_files(name: str) -> None:
    amounts = AMOUNTS[name]
    one = Accepted(1, name, amounts, tuple(0.01 for _ in amounts))
    new = corrected(MACHINE, [one])
    changed = {
        f"{r.mount}": (r.position[0] - old.position[0], r.position[1] - old.position[1])
        for r, old in zip(new.receiver, MACHINE.receiver, strict=True)
        if r != old
    }
    match name:
        case "wheel_angle":
            assert new.wheel_angle.zero.value == pytest.approx(
                MACHINE.wheel_angle.zero.value + 1.0027, abs=1e-3
            )
        case "drawbar":
            assert new.implement.d.value == pytest.approx(MACHINE.implement.d.value - 0.12)
        case "pair_tractor" | "pair_implement":
            (front, rear), body = changed.values(), PAIRS.index(name)
            span = float(RIG.levers[body, 0, 0] - RIG.levers[body, 1, 0])
            assert math.asin((front[1] - rear[1]) / span) == pytest.approx(amounts[0])
            assert abs(front[0] - rear[0]) < span * amounts[0] ** 2
        case _:
            assert changed == {name: pytest.approx(amounts)}
    assert demo_machine() == MACHINE  # the old one is as it was
    assert HYPOTHESIS[name].key and "sd = " in line_of(new, name)
    assert line_of(new, name) in notice_sentence(acceptance(new, one))


def test_what_is_not_known_is_not_accepted() -> None:
    with pytest.raises(ValueError, match="nothing that can be accepted"):
        corrected(MACHINE, [Accepted(1, "cab", (0.1, 0.1), (0.01, 0.01))])
