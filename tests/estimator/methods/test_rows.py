"""Straight rows as a method: blocks, adoption, what is withheld, and what the given rows tell."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from circle import demo_machine
from numpy.typing import NDArray
from paths import shared
from rich.console import Console
from straight_row import on_a_rut

from tilth.analysis.runs.driving import driving
from tilth.analysis.runs.run import open_runs
from tilth.cli.replay import _table
from tilth.client.received import estimate_of
from tilth.estimator import fold
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.methods import rows
from tilth.estimator.methods.open_tracker import from_file, opened
from tilth.estimator.methods.rows import Fit, Job, RowsState
from tilth.estimator.record import straight_rows
from tilth.estimator.record.record import Record, Segment, concatenate
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.logger.machine_file import read_machine
from tilth.schemas.channels import CHANNELS
from tilth.schemas.flow import PARAMETERS, BodyPose, Estimate, Pose, Status
from tilth.schemas.machine import Quantity
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]

MACHINE = demo_machine()
S = 1_000_000_000
START = 5 * S


def pose_at(t_ns: int) -> Pose:
    body = BodyPose(0.0, 0.0, 0.02, 0.0, 0.005, 4.0, 0.0, 0.03, 0.04, 0.0, 0.003, 0.0, 0.004)
    return Pose(t_ns, 43.5, -83.4, body, body, 0.0, 0.007, 0.0, 0.002, 1, None, 0.0, 4, ())


def drive(state: RowsState, seconds: float, t_ns: int = START) -> int:
    """Straight on; the instant after it."""
    for _ in range(round(seconds / 0.2)):
        ticks = np.zeros((10, 8))
        ticks[:, 1] = 4.0
        segment = Segment(Record(t_ns, ticks, np.zeros((0, 6))), t_ns > START, None)
        t_ns = segment.record.end_ns
        rows.take(state, MACHINE, pose_at(t_ns), segment)
    return t_ns


def result(state: RowsState, job: Job, **changed: Any) -> Fit:
    covariance = 0.01 * job.covariance
    made = Fit(job.mean + 0.1, covariance, 0.9, math.radians(0.5), 110.0, 5, -6.0, False, False, None)
    return replace(made, **changed)


@pytest.mark.parametrize("tips", [0.0, 1.0])
def test_a_front_axle_may_tip_as_its_tyres_let_it_or_not_at_all(tips: float) -> None:
    """Over what the file's stiffness makes of it; how much one sd of the prior changes it."""
    state = rows.initial(MACHINE)
    at, sd = AT["roll_front"], math.sqrt(state.covariance[AT["roll_front"], AT["roll_front"]])
    said = math.exp(-state.mean[at])
    assert abs(said - tips) < 1.2 * said * sd


@pytest.mark.long
@pytest.mark.parametrize("stiffer", [0.0, 3.4])  # as its tyres let it; not at all
def test_relaxation_lengths_hold_whether_the_front_axle_tips_or_not(stiffer: float) -> None:
    """By their mean error over the sd in four rows of a tractor with a high pin."""
    tractor = MACHINE.tractor.model_copy(update={"pivot_height": Quantity(value=0.95, sd=0.1)})
    machine = MACHINE.model_copy(update={"tractor": tractor})
    mean, _ = unknowns.prior(machine)
    mean[AT["roll_front"]] += stiffer
    state, off = rows.initial(machine), []
    for seed in (0, 1, 2, 6):
        row = on_a_rut(45.0, seed, mean, rig_setup(machine))
        made = rows.fit(machine, Job(0, row.end_ns, [row], False, state.mean, state.covariance))
        off.append((made.mean - mean)[3] / math.hypot(math.sqrt(made.covariance[3, 3]), state.model_sd[3]))
    assert abs(np.mean(off)) < 0.8


def test_a_first_number_after_two_minutes_and_a_better_one_of_the_whole_block() -> None:
    state = rows.initial(MACHINE)
    nothing = rows.estimate(state, MACHINE, START)
    assert {p.reason.code for p in nothing.parameters if p.reason} == {Code.NO_ROWS_YET}
    t_ns = drive(state, 119.0)
    assert rows.request_fit(state, t_ns) is None
    t_ns = drive(state, 1.4, t_ns)
    job = rows.request_fit(state, t_ns)
    assert job is not None and not job.full and rows.request_fit(state, t_ns) is None
    first = rows.adopt(state, MACHINE, result(state, job), t_ns)
    assert all(p.status is Status.ESTIMATED for p in first.parameters) and first.own_steering is not None
    t_ns = drive(state, 180.0, t_ns)
    again = rows.request_fit(state, t_ns)
    assert again is not None and np.array_equal(
        again.mean, job.mean
    )  # from before the block, not from its number
    rows.adopt(state, MACHINE, result(state, again), t_ns)
    t_ns = drive(state, 300.0, t_ns)
    last = rows.request_fit(state, t_ns)
    assert last is not None and last.full and np.array_equal(last.mean, job.mean)
    rows.adopt(state, MACHINE, result(state, last), t_ns)
    t_ns = drive(state, 121.0, t_ns)
    following = rows.request_fit(state, t_ns)
    assert following is not None and np.array_equal(following.mean, state.mean)
    assert following.rows[0].t_ns >= last.closed_ns


def test_a_fit_of_rows_is_recommended_at_once_where_turns_told_nothing() -> None:
    """As soon as the machine file is confirmed, and only then."""
    state = fold.initial(MACHINE)
    rows_state = state.estimators[rows.METHOD]
    t_ns = drive(rows_state, 121.0)
    for confirmed in (False, True):
        state.diagnosis.consistency.confirmed = state.diagnosis.consistency.judged = confirmed
        job = rows_state.job = rows_state.job or rows.request_fit(rows_state, t_ns)
        assert job is not None
        published = fold.adopt(state, t_ns, rows.METHOD, result(rows_state, job, mean=job.mean))
        rows_state.job = job
        estimates = [p.value for p in published if isinstance(p.value, Estimate)]
        own, best = estimates
        assert (own.method, best.method) == ("rows", "recommended")
        assert best.parameters[0].value == own.parameters[0].value
        assert (best.parameters[0].value is not None) == confirmed
        assert best.rule == Reason(Code.ROWS_ALONE if confirmed else Code.NO_METHOD, ("rows",) * confirmed)


@pytest.mark.parametrize(("e_off", "given"), [(0.0, True), (0.1, True), (3.0, False)])
def test_rows_alone_have_numbers_with_a_file_that_they_find_right(e_off: float, given: bool) -> None:
    """Without a turn, by what they find with its numbers open; e is that much longer than the file says."""
    state = fold.initial(MACHINE)
    rows_state, consistency = state.estimators[rows.METHOD], state.diagnosis.consistency
    t_ns = drive(rows_state, 121.0)
    job = rows.request_fit(rows_state, t_ns)
    assert job is not None
    off, found = np.zeros(len(rows_state.mean)), []
    off[AT["e"]] = e_off
    for sd in (opened(rows_state.prior_sd), rows_state.prior_sd):
        covariance, both = np.diag((0.1 * sd) ** 2), (AT["C_ai"], AT["e"])
        covariance[both] = covariance[both[::-1]] = 0.005 * sd[both[0]] * sd[both[1]]
        found.append(covariance)
    opening, believing = found
    consistency.rates_known = True
    made = result(rows_state, job, mean=job.mean, of_file=from_file(off, opening, believing, MACHINE))
    own, best = (p.value for p in fold.adopt(state, t_ns, rows.METHOD, made) if isinstance(p.value, Estimate))
    assert (own.parameters[0].value is not None) == given and best.rule is not None
    assert not consistency.judged and not consistency.confirmed
    if given:
        assert best.rule.code is Code.ROWS_ALONE
        added = np.reshape(own.log_covariance, (6, 6)) - rows.published_covariance(rows_state)
        assert added[2, 2] > added[0, 0] >= 0.0


@pytest.mark.parametrize("lost", ["dropped", "refused"])
def test_what_a_full_block_told_earlier_stays_if_its_last_fit_is_lost(lost: str) -> None:
    state = rows.initial(MACHINE)
    t_ns = drive(state, 121.0)
    job = rows.request_fit(state, t_ns)
    assert job is not None
    rows.adopt(state, MACHINE, result(state, job), t_ns)
    mean = state.mean.copy()
    while not (job is not None and job.full):
        t_ns = drive(state, 1.0, t_ns)
        job = rows.request_fit(state, t_ns)
        if job is not None:
            made = (
                None if lost == "dropped" else result(state, job, refused=Code.NOT_CONVERGED, mean=job.mean)
            )
            rows.adopt(state, MACHINE, made, t_ns)
    assert np.array_equal(state.mean, mean) and np.array_equal(state.before_mean, mean)
    assert state.job is None and len(state.events) == 2


def test_steering_that_only_answers_the_ground_is_withheld_and_said() -> None:
    state = rows.initial(MACHINE)
    t_ns = drive(state, 121.0)
    job = rows.request_fit(state, t_ns)
    assert job is not None
    made = result(state, job, refused=Code.LITTLE_OWN_STEERING, own_share=0.2, own_rms=math.radians(0.1))
    found = rows.adopt(state, MACHINE, made, t_ns)
    assert all(p.value is None for p in found.parameters) and not state.fits
    drive(state, 2.0, t_ns)
    found = rows.estimate(state, MACHINE, t_ns)
    (why,) = {p.reason for p in found.parameters}
    assert why is not None and why.because[0].code is Code.LITTLE_OWN_STEERING
    (channel,) = (c for c in CHANNELS if c.topic == "/soil_tire/rows")
    message = pb.SoilTireEstimate.FromString(channel.encode(found))
    assert message.own_steering.share == pytest.approx(0.2) and message.own_steering.seconds == 110.0
    assert "dither" in message.parameters[0].reason
    assert estimate_of(channel.encode(found), channel.encoding).own_steering == found.own_steering
    console = Console(width=160)
    with console.capture() as shown:
        console.print(_table("rows", found))
    assert "20 % of it, 0.10° rms" in shown.get()


@pytest.mark.parametrize(
    ("before_s", "adopted", "last_s"),
    [
        (0.0, True, 0.0), (15.0, True, 0.0),  # too short for a row
        (60.0, True, 60.0), (119.0, True, 119.0),  # too short for a first number without a stop
        (120.0, True, 0.0), (200.0, True, 200.0),  # nothing of it is not fitted; 80 s are not
        (200.0, False, 0.0),  # its fit is late
    ],
)  # fmt: skip
def test_a_stop_ends_a_block_and_what_is_there_is_fitted(
    before_s: float, adopted: bool, last_s: float
) -> None:
    """The last fit has so many seconds, and the next block none of them."""
    state, t_ns, jobs = rows.initial(MACHINE), START, list[Job]()
    for _ in range(round(before_s)):
        t_ns = drive(state, 1.0, t_ns)
        jobs += [job] if (job := rows.request_fit(state, t_ns)) else []
        if state.job is not None and adopted:
            rows.adopt(state, MACHINE, result(state, state.job), t_ns)
    first = len(jobs)
    rows.stood(state)
    stood_ns = t_ns
    jobs += [job] if (job := rows.request_fit(state, t_ns)) else []
    assert [job.rows[-1].end_ns - job.rows[0].t_ns for job in jobs[first:]] == [last_s * S] * (last_s > 0.0)
    assert all(job.full for job in jobs[first:])
    assert all(straight_rows.is_long(job.rows) == (last_s >= 120.0) for job in jobs[first:])
    if state.job is not None:
        rows.adopt(state, MACHINE, result(state, state.job), t_ns)
    assert np.array_equal(state.before_mean, state.mean) and not state.block.row and not state.block.complete
    assert rows.estimate(state, MACHINE, t_ns).excitation["stops"] == 1.0
    t_ns = drive(state, 121.0, t_ns)
    following = rows.request_fit(state, t_ns)
    assert following is not None and not following.full and following.rows[0].t_ns >= stood_ns


def test_a_stored_state_goes_on_alike() -> None:
    state = rows.initial(MACHINE)
    t_ns = drive(state, 130.0)
    again = from_json_data(RowsState, json.loads(json.dumps(to_json_data(state))))
    for one in (state, again):
        drive(one, 5.0, t_ns)
    jobs = [rows.request_fit(one, t_ns) for one in (state, again)]
    assert to_json_data(jobs[0]) == to_json_data(jobs[1]) and jobs[0] is not None


def test_after_the_clock_stepped_back_only_what_was_learned_stays() -> None:
    state = rows.initial(MACHINE)
    t_ns = drive(state, 121.0)
    job = rows.request_fit(state, t_ns)
    assert job is not None
    rows.adopt(state, MACHINE, result(state, job), t_ns)
    informed = state.informed_ns
    rows.clock_stepped(state, -S)
    assert not state.block.row and state.informed_ns == informed - S
    assert np.array_equal(state.before_mean, state.mean)


def test_two_minutes_of_given_rows_tell_the_six() -> None:
    stem = shared("data/rows") / "rowsw0"
    truth = json.loads(stem.with_suffix(".truth.json").read_text(encoding="utf-8"))
    (run,) = open_runs(stem.with_suffix(".log.gz"), machine=read_machine(f"{stem}.toml"))
    machine = run.machine
    segments = [d.segment for d in driving(run) if d.segment is not None and d.segment.reason is None]
    record = concatenate(segments[200:800])
    state = rows.initial(machine)
    found = rows.fit(machine, Job(0, record.end_ns, [record], False, state.mean, state.covariance))
    sds = np.sqrt(np.diag(found.covariance))[:6]
    off = found.mean[:6] - np.log([truth[name] for name in PARAMETERS])
    assert found.refused is None and found.own_share > 0.9
    assert np.all(np.abs(off) < 2.5 * sds) and np.all(sds < (0.2, 0.3, 0.35, 0.3, 0.35, 0.5))


@pytest.mark.long
def test_rows_side_by_side_tell_which_of_them_is_on_softer_soil() -> None:
    """By turns on usual soil and on half as firm a one, in one block: its value is between, its pieces are
    not, and together they tell what it tells."""
    state, contrasts, off = rows.initial(MACHINE), list[float](), list[Array]()
    weak = np.diag(state.prior_sd[:6] ** -2.0)
    for seed in range(3):
        firm = state.prior_mean.copy()
        firm[:6] += 0.2 * np.random.default_rng(seed).standard_normal(6)
        soft = firm - 0.5 * (np.arange(len(firm)) < 3)
        driven = [on_a_rut(45.0, 100 * seed + k, (firm, soft)[k % 2], rig_setup(MACHINE)) for k in range(4)]
        records = [Record(60 * S * k, row.ticks, row.rows) for k, row in enumerate(driven)]
        made = rows.fit(MACHINE, Job(0, records[-1].end_ns, records, False, state.mean, state.covariance))
        assert made.told is not None and len(made.pieces) == 4 * 5  # of 40 m at most
        for part in ("information", "vector"):
            total = sum(getattr(piece.told, part) for piece in made.pieces)
            np.testing.assert_allclose(total, getattr(made.told, part), atol=1e-9 * np.max(np.abs(total)))
        values = []
        for true, side in ((firm, 0), (soft, 1)):
            own = [p.told for p in made.pieces if p.begin_ns // (60 * S) % 2 == side]
            covariance = np.linalg.inv(np.sum([one.information for one in own], axis=0) + weak)
            values.append(covariance @ np.sum([one.vector for one in own], axis=0))
            of_model = np.diag(covariance) + own[0].model_sd ** 2
            off.append((values[-1] - (true - state.prior_mean)[:6]) / np.sqrt(of_model))
        contrasts.append(float((values[1] - values[0])[:3].mean()))
    assert np.mean(contrasts) == pytest.approx(-0.5, abs=0.2)
    assert np.mean(np.abs(off) < 2.0) >= 0.9
