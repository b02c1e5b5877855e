"""Guidance of the implement: plan, law, controller, and the whole loop on the nonlinear tractor."""

import math
from dataclasses import replace

import can
import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.adaptive_guidance.controller import COMMAND, LIMITS, STALE, Controller
from tilth.adaptive_guidance.law import design
from tilth.adaptive_guidance.lockstep import cross_track, run
from tilth.adaptive_guidance.plan import STEP, Plan, Work, plan
from tilth.adaptive_guidance.wires import throw_away
from tilth.client import Cautious, Limits
from tilth.client.latest import judge
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.schemas.can_id import split
from tilth.schemas.flow import (
    PARAMETERS,
    BodyPose,
    Estimate,
    ParameterEstimate,
    Pose,
    SoilPlace,
    Status,
)
from tilth.schemas.machine import Machine
from tilth.schemas.pgn_table import row
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import ORIGIN_DEG, Ground, Scenario, Soil, SoilChange

WORK = Work(rows=3, length=40.0, spacing=48.0, radius=18.0)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return packaged_file().machine


@pytest.fixture(scope="module")
def nominal(machine: Machine) -> Rig:
    return rig_of(machine)


@pytest.fixture(scope="module")
def line(nominal: Rig) -> Plan:
    return plan(WORK, nominal)


def test_the_plan_is_one_that_rolling_wheels_can_follow(line: Plan, nominal: Rig) -> None:
    for body, behind in ((line.tractor, nominal.b), (line.implement, nominal.towed_length - nominal.d)):
        heading = np.column_stack([np.cos(body[:, 2]), np.sin(body[:, 2])])
        axle = body[:, :2] - behind * heading
        way = np.gradient(axle, STEP, axis=0)
        sideways = way[:, 1] * heading[:, 0] - way[:, 0] * heading[:, 1]
        assert np.abs(sideways[2:-2]).max() < 0.01
    gap = line.tractor[:, :2] - nominal.c * _ahead(line.tractor) - line.implement[:, :2]
    assert np.allclose(gap, nominal.d * _ahead(line.implement))  # the hitch holds
    ends = [np.flatnonzero(line.row == k)[-1] for k in range(WORK.rows)]
    assert line.tractor[ends, 1] == pytest.approx([0.0, 48.0, 96.0], abs=0.1)
    assert np.cos(line.tractor[ends, 2]) == pytest.approx([1.0, -1.0, 1.0], abs=1e-3)


def _ahead(body: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.cos(body[:, 2]), np.sin(body[:, 2])])


def test_in_two_lands_the_next_row_but_one_is_beside(nominal: Rig) -> None:
    work = Work(rows=6, length=40.0, spacing=42.0, radius=12.0, beside=6.0)
    line = plan(work, nominal)
    ends = [np.flatnonzero(line.row == k)[-1] for k in range(work.rows)]
    assert line.tractor[ends, 1] == pytest.approx([0.0, 42.0, 6.0, 48.0, 12.0, 54.0], abs=0.1)
    assert np.cos(line.tractor[ends, 2]) == pytest.approx([1.0, -1.0] * 3, abs=1e-3)


def test_a_turn_that_does_not_fit_is_said(nominal: Rig) -> None:
    with pytest.raises(ValueError, match="smaller radius"):
        plan(Work(spacing=20.0, radius=18.0), nominal)


@pytest.mark.parametrize("speed", [0.5, 2.0, 4.5, 7.0])
@pytest.mark.parametrize("factor", [0.3, 1.0, 3.0])
def test_the_law_steadies_what_it_is_made_for(nominal: Rig, speed: float, factor: float) -> None:
    soil = dict(zip(PARAMETERS, (nominal.theta * factor).tolist(), strict=True))
    made = design(nominal._replace(**soil), speed)
    n = len(made.f)
    whole = np.block([[made.f, made.g[:, None]], [np.zeros((1, n)), np.eye(1)]])
    whole[n] -= 0.02 * made.gain
    assert np.abs(np.linalg.eigvals(whole)).max() < 1.0
    assert all(np.isfinite(part).all() for part in made[2:])


# The controller.


def pose(at_s: float, x: float = 20.0, y: float = 0.0, **changes: object) -> Pose:
    body = BodyPose(x, y, 0.01, 0.0, 0.01, 4.5, 0.0, 0.05, 0.07, 0.0, 0.01, 0.0, 0.01)
    towed = replace(body, x=x - 5.72)
    one = Pose(
        round(at_s * 1e9), *ORIGIN_DEG, body, towed, 0.0, 0.02, 0.0, 0.01, 1, None, 0.0, 4, ()
    )  # fmt: skip
    return replace(one, **changes)  # type: ignore[arg-type]


def command_at(controller: Controller, now: float) -> tuple[str, float]:
    ((can_id, data),) = controller.command(now)
    assert split(can_id).pgn == COMMAND
    words = row(COMMAND).layout.decode(data, {})
    return str(words["command_status"]), float(words["commanded_curvature_per_m"])


def test_it_steers_only_by_poses_that_are_whole_and_fresh(line: Plan, nominal: Rig) -> None:
    subject = Controller(line, nominal, ORIGIN_DEG)
    assert command_at(subject, 0.1) == ("not_intended", 0.0)
    subject.pose(pose(0.1, wheel_angle=None), 0.1)
    assert (command_at(subject, 0.2)[0], subject.reason, subject.unusable) == (
        "not_intended",
        "no pose yet",
        1,
    )
    subject.pose(pose(0.2), 0.2)
    assert (command_at(subject, 0.3)[0], subject.reason) == ("intended", "")
    subject.pose(pose(0.1), 0.1)  # an old one changes nothing
    assert command_at(subject, 0.4)[0] == "intended"
    assert command_at(subject, 1.4)[0] == "not_intended"
    assert subject.reason == "the last pose is 1.2 s old"


def test_off_the_line_to_the_left_it_steers_to_the_right_at_a_limited_rate(line: Plan, nominal: Rig) -> None:
    subject = Controller(line, nominal, ORIGIN_DEG)
    subject.pose(pose(0.0, y=-0.5), 0.0)
    bends = [command_at(subject, 0.1 * k)[1] for k in range(8)]
    assert bends[-1] > 0.001
    angles = np.arctan(nominal.wheelbase * np.array(bends))
    assert np.abs(np.diff(angles)).max() < math.radians(20.0) * 0.1 + 1e-3


def estimate(factor: float, status: Status = Status.ESTIMATED) -> Estimate:
    values = rig_of(packaged_file().machine).theta * factor
    rows = tuple(ParameterEstimate(float(v), 0.05 * float(v), status, None, 1.0) for v in values)
    return Estimate(1, "recommended", "relaxation", rows, tuple((0.0025 * np.eye(6)).ravel().tolist()), ())


@pytest.mark.parametrize(
    ("estimate_told", "age_s"),
    [
        (estimate(0.6), 3.5),  # stale
        (estimate(0.6, Status.INVALID), 0.1),
        (estimate(0.6, Status.STALE), 0.1),
        (None, math.inf),
    ],
)
def test_what_may_not_be_used_brings_back_the_nominal_gains_smoothly(
    line: Plan, nominal: Rig, estimate_told: Estimate | None, age_s: float
) -> None:
    subject = Controller(line, nominal, ORIGIN_DEG)
    now = 0.0
    for _ in range(100):
        now += 0.1
        subject.estimate(judge(estimate(0.6), 0.1, STALE), now)
    assert (subject.follower.theta < 0.65 * nominal.theta).all()
    before = subject.follower.theta
    for _ in range(100):
        now += 0.1
        subject.estimate(judge(estimate_told, age_s, STALE), now)
        step = np.abs(np.log(subject.follower.theta / before)).max()
        assert step <= LIMITS.per_s * 0.1 + 1e-9
        before = subject.follower.theta
    assert before == pytest.approx(nominal.theta)


def test_a_dither_is_added_in_rows_while_a_stiffness_is_unknown(line: Plan, nominal: Rig) -> None:
    moved = {}
    for sd in (0.05, 0.3):
        subjects = [
            Controller(line, nominal, ORIGIN_DEG, replace(LIMITS, shadow=True), dither)
            for dither in (0.0, 0.005)
        ]
        rows = tuple(replace(p, sd=sd * (p.value or 0.0)) for p in estimate(1.0).parameters)
        off = []
        for k in range(30):
            now = 0.1 * k
            for subject in subjects:
                subject.estimate(judge(replace(estimate(1.0), parameters=rows), 0.1, STALE), now)
                subject.pose(pose(now, x=20.0 + 0.45 * k), now)
            bends = [command_at(subject, now)[1] for subject in subjects]
            off.append(nominal.wheelbase * (bends[1] - bends[0]))
        moved[sd] = np.std(off)
    assert moved[0.05] == 0.0 and 0.001 < moved[0.3] < 0.01


def test_in_patches_it_steers_for_the_soil_ahead(line: Plan, nominal: Rig) -> None:
    """By its mean, also where that is too wide for a number, and not where soil is hardly in patches."""
    means, wide = tuple(np.log(0.6 * nominal.theta).tolist()), tuple((0.2 * np.eye(6)).ravel().tolist())
    blank = [replace(p, value=None, sd=None, status=Status.UNESTIMATED) for p in estimate(0.6).parameters]
    there = replace(
        estimate(0.6), parameters=tuple(blank), log_covariance=wide,
        of_place=SoilPlace(*ORIGIN_DEG, 30.0, 0.2, 0.2, 0.6, means),
    )  # fmt: skip
    told = {}
    for patchy in (0.9, 0.4):
        subject = Controller(line, nominal, ORIGIN_DEG)
        assert subject.ahead() is None
        subject.pose(pose(0.2, x=20.0 + nominal.b), 0.2)
        assert subject.ahead() == pytest.approx((24.5, 0.0), abs=0.1)
        ahead = judge(replace(there, excitation={"patchy": patchy}), 0.1, STALE)
        for k in range(100):
            subject.estimate(judge(estimate(1.0), 0.1, STALE), 0.1 * k, ahead)
        told[patchy] = np.log(subject.follower.theta / nominal.theta)
    distance = abs(math.log(0.6)) * math.sqrt(6.0 / 0.2)
    assert told[0.9] == pytest.approx(np.full(6, math.log(0.6)) * (1.0 - 1.0 / distance))
    assert told[0.4] == pytest.approx(np.zeros(6))


@pytest.mark.parametrize(
    ("sds", "share"),
    [
        (0.5, 0.0),
        (2.9, 0.0),  # chance alone makes such an estimate
        (6.0, 0.5),
        (30.0, 0.9),
    ],
)
def test_nominal_gains_are_left_only_by_what_the_data_cannot_do_without(sds: float, share: float) -> None:
    nominal = np.ones(6)
    off = sds * 0.05 / math.sqrt(6.0) * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    rows = tuple(ParameterEstimate(float(v), 0.05, Status.ESTIMATED, None, 1.0) for v in np.exp(off))
    told = Estimate(1, "recommended", "", rows, tuple((0.0025 * np.eye(6)).ravel().tolist()), ())
    cautious = Cautious(nominal, Limits(ratio=10.0, per_s=0.1, doubt_sd=3.0))
    force = cautious.step(judge(told, 0.1, STALE), 0.0)
    assert np.log(force.wanted) == pytest.approx(share * off)
    assert all("sd from" in note for note in force.notes)


@pytest.mark.parametrize("doubt_sd", [-1.0, math.nan, math.inf])
def test_a_doubt_that_is_none_is_said(doubt_sd: float) -> None:
    with pytest.raises(ValueError, match="doubt_sd"):
        Limits(ratio=3.0, per_s=0.1, doubt_sd=doubt_sd)


# The whole loop.


def with_sure_inertias(machine: Machine) -> Machine:
    """The soil alone is to differ from what the controller takes it for."""
    sure = {
        name: body.model_copy(update={"yaw_inertia": body.yaw_inertia.model_copy(update={"sd": 0.0})})
        for name, body in (("tractor", machine.tractor), ("implement", machine.implement))
    }
    return machine.model_copy(update=sure)


@pytest.mark.long
def test_who_knows_a_soft_soil_keeps_the_implement_nearer_to_its_line_in_the_turn(
    machine: Machine, nominal: Rig
) -> None:
    soil = Soil(
        parameters=dict(zip(PARAMETERS, nominal.theta.tolist(), strict=True)),  # type: ignore[arg-type]
        changes=(SoilChange(at_s=0.0, C_af=0.6, C_ar=0.6, C_ai=0.6),),
    )
    scenario = Scenario(speed=4.5, soil=soil, ground=Ground(roll_sd_deg=0.5, force_sd=0.01))
    work = replace(WORK, rows=2, length=15.0)
    errors = {}
    for mode in ("fixed", "knowing"):
        line, truth, received = run(with_sure_inertias(machine), 1, scenario, work, mode)
        assert received.refused == {}
        assert received.ended == "done"
        off, at = cross_track(line, truth)
        errors[mode] = np.sqrt(np.mean(off[line.row[at] < 0] ** 2))
    assert errors["knowing"] < 0.15
    assert errors["knowing"] < 0.85 * errors["fixed"]


def test_what_others_say_on_the_bus_is_thrown_away() -> None:
    """A bus whose frames nobody reads fills, and over TCP then holds up who sends."""
    with can.Bus("others", "virtual") as ours, can.Bus("others", "virtual") as others:
        for k in range(900):
            others.send(can.Message(arbitration_id=k, is_extended_id=True))
        throw_away(ours)
        assert ours.recv(0.0) is None
