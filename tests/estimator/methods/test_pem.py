"""The fit of all six parameters: on data of its own model, on frames of the virtual tractor, and as a job."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import linear_plant
import numpy as np
import pytest
import spatial_logs
from logs import MACHINE
from numpy.typing import NDArray
from scipy.linalg import expm
from season import rig_of as rig_of_season
from season import scenario_for

from tilth.estimator.filters import likelihood, scoring, unknowns
from tilth.estimator.filters.contrast import Contrast
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.scoring import maximise_posterior
from tilth.estimator.filters.states import DT, START, X_ALPHA, X_PSI, X_R, X_V
from tilth.estimator.filters.unknowns import AT, NAMES, NOISES, SHAPE, SIX
from tilth.estimator.fold import initial, step
from tilth.estimator.methods import pem
from tilth.estimator.methods.learned import into_pem, of_pem
from tilth.estimator.models import relaxation
from tilth.estimator.models.manoeuvres import manoeuvre_named
from tilth.estimator.models.parameters import TABLE_7_2, Rig, rig_of
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import HEADING, YAW_RATE, Record, Segment, concatenate
from tilth.estimator.results.method_state import take_events
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.replay.readers.any_log import frames
from tilth.schemas.flow import PARAMETERS, BodyPose, Estimate, Frame, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.notices import reasoned
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import notice_sentence, sentence
from tilth.simulator.drive import drive
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.scenario import DrivenManoeuvre, Fieldwork, Scenario, Soil
from tilth.simulator.traffic import traffic

Array = NDArray[np.float64]

DISTURBANCES, MEMORY = (0.3, 0.15, 0.05), 0.1  # as unknowns.NOISES
LASTS = math.exp(-DT / MEMORY)
SDS = (math.radians(0.2), math.radians(0.3))
SPEED = 4.5
PLANAR = [X_V, X_R, X_R + 1, X_ALPHA, X_ALPHA + 1, X_ALPHA + 2, X_PSI, X_PSI + 1]
SECOND = 1_000_000_000


def discrete(rig: Rig) -> tuple[Array, Array, Array]:
    """(F, G, pushed) of the states PLANAR of the predictor for themselves, a wheel angle and the
    ground's three pushes, by a matrix exponential."""
    a = relaxation.system_matrix(SPEED, rig.geometry, rig.theta)
    b = relaxation.input_matrix(SPEED, rig.geometry, rig.theta)
    keep = [0, 1, 2, 3, 4, 5, 7, 8]
    whole = np.zeros((12, 12))
    whole[:8, :8], whole[:8, 8:11], whole[1, 11] = a[np.ix_(keep, keep)], b[keep], 1.0
    exact: Array = np.asarray(expm(whole * DT), np.float64)
    return exact[:8, :8], exact[:8, 8], exact[:8, 9:]


def record_of_own_model(rig: Rig, seed: int, seconds: float = 30.0, kind: str = "random") -> Record:
    """Gyros and headings at every tick of a rig that moves as the relaxation model on uneven ground."""
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    time: Array = np.arange(n, dtype=np.float64) * DT
    wheel = manoeuvre_named(kind).wheel_angle(time, math.radians(8.0), rng)
    f, g, disturbance_gain = discrete(rig)
    states, disturbance = np.zeros((n, 8)), rng.standard_normal((n, 3)) * DISTURBANCES
    for k in range(n - 1):
        states[k + 1] = f @ states[k] + g * (wheel[k] + wheel[k + 1]) / 2 + disturbance_gain @ disturbance[k]
        disturbance[k + 1] = LASTS * disturbance[k] + math.sqrt(1.0 - LASTS**2) * disturbance[k + 1]
    ticks = np.zeros((n, 8))
    ticks[:, 0], ticks[:, 1], ticks[:, 2:4], ticks[:, 4:6] = wheel, SPEED, states[:, 6:8], states[:, 1:3]
    rows = [
        (k, 0.0, kind_, body, states[k, column + body] + sd * rng.standard_normal(), sd)
        for k in range(n)
        for kind_, column, sd in ((YAW_RATE, 1, SDS[0]), (HEADING, 6, SDS[1]))
        for body in (0, 1)
    ]
    return Record(0, ticks, np.array(rows))


def alone(machine: Machine) -> tuple[Array, Array]:
    """(mean, covariance) where only the six, the zero and the noise levels are not known."""
    mean, sd = unknowns.prior(machine)
    open_ = {*PARAMETERS, "wheel_zero", *NOISES} - {"s_velocity", "uneven", "s_roll"}
    sd = np.where([name in open_ for name in NAMES], sd, 0.0)
    for name in ("rolling", "curvature", "rate_late_t", "rate_late_i"):
        mean[AT[name]] = 0.0
    return mean, np.diag(sd**2)


def without_pairs(machine: Machine) -> RigSetup:
    return rig_setup(machine, linear=True)._replace(sds=np.zeros(4))


def test_the_likelihood_is_that_of_one_large_normal_distribution(machine: Machine) -> None:
    """Against the dense covariance of all measurements at once, built without any filter."""
    rig = TABLE_7_2
    record = record_of_own_model(rig, 3, seconds=0.6)
    mean, _ = alone(machine)
    mean[SIX] = np.log(rig.theta)
    mean[AT["push_t"] : AT["memory"] + 1] = np.log([*DISTURBANCES, MEMORY])
    setup = without_pairs(machine)
    first_state = likelihood.first_state(record, setup)
    found = likelihood.innovations(record, setup, first_state, mean)
    f, g, disturbance_gain = discrete(rig)
    whole_f = np.block([[f, disturbance_gain], [np.zeros((3, 8)), LASTS * np.eye(3)]])
    n, first = len(record.ticks), first_state[PLANAR]
    start = np.diag(np.square([*np.array(START)[PLANAR], *DISTURBANCES]))
    shock = np.diag([*[0.0] * 8, *((1.0 - LASTS**2) * np.square(DISTURBANCES))])
    centre, spreads = [first], [start]
    for k in range(n - 1):
        wheel_angle = (record.ticks[k, 0] + record.ticks[k + 1, 0]) / 2
        centre.append(f @ centre[-1] + g * wheel_angle)
        spreads.append(whole_f @ spreads[-1] @ whole_f.T + shock)
    columns = [1 + int(r[3]) if r[2] == YAW_RATE else 6 + int(r[3]) for r in record.rows]
    ticks = record.rows[:, 0].astype(int)
    dense = np.diag(record.rows[:, 5] ** 2)
    powers = [np.linalg.matrix_power(whole_f, k) for k in range(n)]
    for i, (ki, ci) in enumerate(zip(ticks, columns, strict=True)):
        for j, (kj, cj) in enumerate(zip(ticks, columns, strict=True)):
            early, late, c_early, c_late = (ki, kj, ci, cj) if ki <= kj else (kj, ki, cj, ci)
            dense[i, j] += (powers[late - early] @ spreads[early])[c_late, c_early]
    off = record.rows[:, 4] - [centre[k][c] for k, c in zip(ticks, columns, strict=True)]
    whole = off @ np.linalg.solve(dense, off) + np.linalg.slogdet(dense)[1]
    # What the wheel angle's noise adds is not in the dense one, nor in this: setup.sds are nothing.
    assert np.sum(found.e**2 / found.S + np.log(found.S)) == pytest.approx(whole, rel=1e-7)


@pytest.mark.coverage
def test_intervals_cover_on_data_of_the_same_model(machine: Machine) -> None:
    """Truths within ±50 % of the prior; bias and coverage over all six."""
    mean, covariance = alone(machine)
    rng = np.random.default_rng(11)
    scores = []
    for seed, kind in enumerate(["random", "chirp", "step"] * 5):
        theta = np.exp(mean[SIX]) * rng.uniform(0.5, 1.5, 6)
        rig = TABLE_7_2._replace(**dict(zip(PARAMETERS, theta.tolist(), strict=True)))
        found = maximise_posterior(
            record_of_own_model(rig, seed, kind=kind), without_pairs(machine), mean, covariance
        )
        scores.append((found.mean[SIX] - np.log(theta)) / np.sqrt(np.diag(found.covariance)[SIX]))
        assert found.converged
    z = np.array(scores)
    assert np.mean(np.abs(z) < 1.96) > 0.88  # 95 % expected of 90, sd 2.3 %
    assert np.sqrt(np.mean(z**2)) < 1.25
    assert np.all(np.abs(z.mean(axis=0)) < 0.75)  # sd of each mean 0.26


@pytest.fixture
def machine() -> Machine:
    return MACHINE


@cache
def _driven(seed: int) -> tuple[Record, Array]:
    machine = MACHINE
    scenario = Scenario(
        seconds=33.0, steering=DrivenManoeuvre("random"), soil=Soil(grip=0.8), other_traffic=False
    )
    truth = drive(machine, seed, scenario.seconds, scenario)
    record = recorded(machine, traffic(machine, truth))
    return record, np.log([truth.parameters[name] for name in PARAMETERS])


def posed(machine: Machine, frames: Iterable[Frame]) -> Iterator[tuple[Pose, Segment | None]]:
    """Each pose of a drive, with the segment that it ends."""
    state, recording = initial(machine), record_builder.initial(machine)
    for frame in frames:
        for publication in step(state, frame):
            if isinstance(pose := publication.value, Pose):
                yield pose, record_builder.observe(recording, state.aligner, pose)


def recorded(machine: Machine, frames: Iterable[Frame]) -> Record:
    """All that a drive has told, as one record."""
    told = [segment for _, segment in posed(machine, frames)]
    return concatenate([segment for segment in told if segment is not None and not segment.reason])


@pytest.mark.coverage
def test_intervals_cover_on_frames_of_the_virtual_tractor(machine: Machine) -> None:
    """Nonlinear plant, coloured RTK noise, latencies and survey errors that the machine file does not
    have."""
    mean, sd = unknowns.prior(machine)
    scores = []
    for seed in range(6):
        record, truth = _driven(seed)
        found = maximise_posterior(record, rig_setup(machine), mean, np.diag(sd**2))
        scores.append((found.mean[SIX] - truth) / np.sqrt(np.diag(found.covariance)[SIX]))
        assert np.all(np.sqrt(np.diag(found.covariance)[SIX]) < 0.2)
    z = np.array(scores)
    assert np.mean(np.abs(z) < 1.96) > 0.8
    assert np.all(np.abs(z) < 4.0)


@pytest.mark.coverage
def test_a_search_does_not_end_where_its_derivatives_promise_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the spatial plant on a side slope: with gains held the search ends 85 nats above the maximum."""
    row = replace(spatial_logs.ROW["spatial_slope"], seconds=33.0)
    spatial_logs.make(tmp_path, row, 38)
    run = spatial_logs.read_run(tmp_path, row.name, 38)
    machine = parse_machine(run.machine_text)
    record, (mean, sd) = recorded(machine, frames(run.log)), unknowns.prior(machine)
    found = maximise_posterior(record, rig_setup(machine), mean, np.diag(sd**2))
    monkeypatch.setattr(scoring, "SEARCH", replace(scoring.SEARCH, empty_promise=math.inf))
    held = maximise_posterior(record, rig_setup(machine), mean, np.diag(sd**2))
    assert (held.cost - found.cost) * found.rows > 20.0
    z = (found.mean[SIX] - np.log([run.described["parameters"][name] for name in PARAMETERS])) / np.sqrt(
        np.diag(found.covariance)[SIX]
    )
    assert (np.abs(z) < 3.0).all()


def test_a_job_is_requested_fitted_and_adopted(machine: Machine) -> None:
    record, truth = _driven(1)
    state = pem.initial(machine)
    state.closed = record
    job = pem.request_fit(state, 5)
    assert job is not None
    assert pem.request_fit(state, 6) is None  # one at a time
    again = from_json_data(pem.PemState, to_json_data(state))
    assert again.job is not None and np.array_equal(again.job.record.rows, record.rows)
    estimate = pem.adopt(state, machine, pem.fit(machine, job), job.closed_ns)
    assert state.job is None
    given = [p for p in estimate.parameters if p.status is Status.ESTIMATED]
    assert len(given) == 6
    assert estimate.rank == 6
    assert all(abs(math.log(p.value or 1.0) - t) < 0.5 for p, t in zip(given, truth, strict=True))
    later = pem.estimate(state, machine, job.closed_ns + 400_000_000_000)
    assert {p.status for p in later.parameters} == {Status.STALE}


def test_a_late_fit_changes_nothing_but_is_counted(machine: Machine) -> None:
    record, _ = _driven(1)
    state = pem.initial(machine)
    state.closed = record
    pem.request_fit(state, 5)
    before = state.mean.copy()
    estimate = pem.adopt(state, machine, None, 6)
    assert state.late == 1
    assert np.array_equal(state.mean, before)
    assert {p.status for p in estimate.parameters} == {Status.UNESTIMATED}
    assert take_events(state) == [("fit", reasoned(Reason(Code.FIT_DROPPED)))]


@pytest.mark.long
def test_windows_of_headlands_leave_a_right_file_right() -> None:
    """What windows have wrong in common adds up in what they carry: with the noise that the speed has between
    two poses these make the inertias larger by 3.5 and 4.4 sds."""
    rig = rig_of_season(0, full=True)
    machine, asked = parse_machine(owners_text(rig, exact=True)), scenario_for(rig, 0, 0, minutes=2.4)
    assert isinstance(asked.steering, Fieldwork)
    uniform = replace(asked.soil, patch_log_sd=0.0, patch_seed=None)
    scenario = replace(asked, soil=uniform, steering=replace(asked.steering, length=40.0))
    truth, state = drive(true_machine(rig), 57, scenario.seconds, scenario), pem.initial(machine)
    for pose, segment in posed(machine, traffic(machine, truth)):
        pem.take(state, machine, pose, segment)
        if (job := pem.request_fit(state, pose.t_ns)) is not None:
            pem.adopt(state, machine, pem.fit(machine, job), pose.t_ns)
    assert state.fits >= 4
    moved = (state.mean - state.prior_mean)[SHAPE] / state.prior_sd[SHAPE]
    assert np.all(np.abs(moved) < 2.0)


@pytest.mark.long
def test_other_soil_is_noticed_and_what_was_learned_given_up(machine: Machine) -> None:
    record, truth = _driven(2)
    state = pem.initial(machine)
    state.mean[SIX] = truth + 0.7  # learned elsewhere, and sure of it
    state.covariance[SIX, SIX] = 0.03**2 * np.eye(6)
    state.fits = 1
    state.closed = record
    job = pem.request_fit(state, 5)
    assert job is not None
    made = pem.fit(machine, job)
    assert made.changed
    pem.adopt(state, machine, made, 6)
    ((kind, told),) = take_events(state)
    factors = [part.values for part in told.parts]
    assert kind == "soil_change" and {one["parameter"] for one in factors} >= {"C_af", "C_ar", "C_ai"}
    assert all(float(one["low"]) < math.exp(-0.7) < float(one["high"]) for one in factors)
    assert notice_sentence(told).count(" × ") == len(factors)
    sd = np.sqrt(np.diag(state.covariance)[SIX])
    assert np.all(np.abs(state.mean[SIX] - truth) < 4.0 * sd)


def test_a_suspicion_that_does_not_stand_changes_nothing(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, truth = _driven(2)
    state = pem.initial(machine)
    state.mean[SIX] = truth + 0.3  # as of softer soil
    state.covariance[SIX, SIX] = 0.1**2 * np.eye(6)
    state.fits, state.closed = 1, record
    job = pem.request_fit(state, 5)
    assert job is not None
    found = []
    for suspected in (math.inf, 0.0):
        never = replace(pem.PEM, suspect_chi_square=suspected, change_chi_square=1e9, change_ratio=1e9)
        monkeypatch.setattr(pem, "PEM", never)
        made = pem.fit(machine, job)
        assert made.told is not None and not made.changed
        found.append((made.mean, made.covariance, made.told.information, made.told.vector))
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


def test_one_row_that_is_no_number_costs_only_the_window(machine: Machine) -> None:
    record, _ = _driven(1)
    rows = record.rows.copy()
    rows[500, 4] = math.nan
    state = pem.initial(machine)
    state.closed = Record(record.t_ns, record.ticks, rows)
    job = pem.request_fit(state, 5)
    assert job is not None
    made = pem.fit(machine, job)
    pem.adopt(state, machine, made, 6)
    assert np.all(np.isfinite(state.mean))
    assert np.all(np.isfinite(state.covariance))


def test_the_beginning_of_a_record_teaches_nothing() -> None:
    """Score of the six at the truth, summed over short records that begin straight: chi-square of six.

    Were the first second judged by the spread that the first state may have, it would be 65.
    """
    setup, (mean, covariance) = linear_plant.setup(MACHINE), linear_plant.prior(MACHINE)
    gradient, information = np.zeros(6), np.zeros((6, 6))
    for seed in range(100):
        run = linear_plant.plant(rig_of(MACHINE), seed, "row", 4.0, 1.8)
        point = mean.copy()
        point[SIX], point[AT["wheel_zero"]] = np.log(run.rig.theta), run.zero
        point[AT["push_t"] : AT["memory"] + 1] = np.log([*linear_plant.DISTURBANCES, linear_plant.MEMORY_S])
        search = likelihood.search_of(linear_plant.record_of(run), setup, point, covariance)
        at = likelihood.with_gains(search, likelihood.evaluate(search, point))
        slope, known = likelihood.gradient_and_information(search, at, likelihood.scores_at(search, at))
        gradient += slope[SIX]
        information += (known - search.prior_information)[SIX, SIX]
    assert gradient @ np.linalg.solve(information, gradient) < 22.5


def test_exact_derivatives_have_in_them_what_the_change_of_the_gains_does() -> None:
    """Those with gains held do not have it: of the roll modes they may even have the wrong sign, and then no
    step along them lowers the cost."""
    record = linear_plant.record_of(linear_plant.plant(rig_of(MACHINE), 1, "random", 8.0, 4.0))
    mean, sd = unknowns.prior(MACHINE)
    mean[AT["uneven"]] += 1.5
    search = likelihood.search_of(record, rig_setup(MACHINE), mean, np.diag(sd**2))
    held = likelihood.evaluate(search, mean)
    names = ("roll_k_t", "roll_k_i", "roll_d_t", "roll_d_i", "C_ar")
    places = [int(np.flatnonzero(search.active == AT[name])[0]) for name in names]

    def cost(k: int, step: float) -> float:
        point = mean + step * np.eye(len(mean))[search.active[k]]
        run = likelihood.innovations(record, search.setup, search.start, point, used=search.used)
        return likelihood._cost(search, point, run.e, run.S)

    wanted = [(cost(k, 1e-4) - cost(k, -1e-4)) / 2e-4 for k in places]
    found = {}
    for exact, at in ((False, held), (True, likelihood.with_gains(search, held))):
        found[exact] = likelihood.gradient_and_information(search, at, likelihood.scores_at(search, at))[0]
    assert found[True][places] == pytest.approx(wanted, rel=0.02, abs=0.05)
    assert (
        np.abs(found[False][places[:4]] - wanted[:4]).max()
        > 10.0 * np.abs(found[True][places] - wanted).max()
    )


def test_what_the_ground_tells_of_other_tyres_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Were the rig's response to the ground that of other tyres, the six would stay; without room for that
    it is the likelihood; in between, the information is."""
    record = linear_plant.record_of(linear_plant.plant(rig_of(MACHINE), 3, "random", 15.0, 4.0))
    mean, sd = unknowns.prior(MACHINE)
    search = likelihood.search_of(record, rig_setup(MACHINE), mean, np.diag(sd**2))
    instruments = likelihood.response_to_steering(search, mean)
    instrument_response = likelihood._run(search, mean, search.active[SIX], instruments=instruments).de.T
    at = likelihood.evaluate(search, mean, instruments=instruments)
    assert (
        np.abs(at.instrument_response - instrument_response).max() < 1e-9 * np.abs(instrument_response).max()
    )
    other = np.array([0.2, -0.1, 0.3, 0.1, -0.3, 0.2])

    def gradient(one: likelihood.Iterate) -> Array:
        found, _ = likelihood.gradient_and_information(search, one, likelihood.scores_at(search, one))
        return found[SIX]

    known = []
    for room, moved_by_ground in ((1e-6, 1.0), (0.3, None), (1e4, 0.0)):
        wider = replace(likelihood.LIKELIHOOD, other_tyres_sd=np.full(6, room))
        monkeypatch.setattr(likelihood, "LIKELIHOOD", wider)
        left, information = likelihood.apart_from_ground(search, at)
        known.append(np.linalg.inv(information)[SIX, SIX])
        by_ground, by_steering = (
            gradient(replace(left, e=left.e + slopes.T @ other)) - gradient(left)
            for slopes in (at.de[SIX] - instrument_response, instrument_response)
        )
        assert np.abs(by_steering).max() > 10.0
        if moved_by_ground is not None:
            all_of = (at.de[SIX] * search.scored / at.S) @ (at.de[SIX] - instrument_response).T @ other
            assert by_ground == pytest.approx(moved_by_ground * all_of, abs=1e-3 * np.abs(all_of).max())
    _, whole = likelihood.gradient_and_information(search, at, likelihood.scores_at(search, at))
    assert known[0] == pytest.approx(np.linalg.inv(whole)[SIX, SIX], rel=1e-4, abs=1e-9)
    for less, more in pairwise(known):
        assert np.linalg.eigvalsh(more - less).min() > -1e-9 and np.all(np.diag(more) > np.diag(less))


# Windows and the age of what was learned.

PARKED = BodyPose(0.0, 0.0, 0.02, 0.0, 0.005, 0.0, 0.0, 0.03, 0.04, 0.0, 0.003, 0.0, 0.004)


def learned_at(t_ns: int) -> pem.PemState:
    """What a fit that was adopted at that time leaves: all six to 10 %."""
    state = pem.initial(MACHINE)
    state.covariance[SIX, SIX] = 0.1**2 * np.eye(6)
    state.fits, state.informed_ns, state.last_pose_ns = 1, t_ns, t_ns
    return state


def along_a_row(
    state: pem.PemState, begin_ns: int, seconds: int, speed: float, reason: Code | None
) -> Estimate:
    """Straight driving at 5 Hz from that time on, with segments of that reason; the last estimate."""
    segment = Segment(Record(0, np.zeros((10, 8))), not reason, reason)
    body = replace(PARKED, forward_velocity=speed)
    pose = Pose(0, 43.5, -83.4, body, PARKED, 0.0, 0.007, 0.0, 0.002, 1, None, 0.0, 4, ())
    for k in range(5 * seconds):
        pem.take(state, MACHINE, replace(pose, t_ns=begin_ns + k * SECOND // 5), segment)
    return pem.estimate(state, MACHINE, begin_ns + seconds * SECOND)


def statuses(estimate: Estimate) -> set[Status]:
    return {p.status for p in estimate.parameters}


def test_a_number_stays_along_rows_until_drift_has_used_it_up() -> None:
    state = learned_at(SECOND)
    estimate = along_a_row(state, SECOND, 1200, 4.0, None)
    assert statuses(estimate) == {Status.ESTIMATED}
    assert estimate.parameters[0].age_s == pytest.approx(1200.0)
    wider = np.sqrt(np.diag(np.reshape(estimate.log_covariance, (6, 6))))
    assert np.all(wider > 0.2) and np.all(wider < 0.35)  # 4.8 km
    state.distance = 60_000.0
    assert statuses(pem.estimate(state, MACHINE, state.sound_ns)) == {Status.UNESTIMATED}


def test_standing_still_ages_nothing_but_silence_and_unsound_data_do() -> None:
    standing = along_a_row(learned_at(SECOND), SECOND, 600, 0.0, Code.TOO_SLOW)
    assert statuses(standing) == {Status.ESTIMATED}
    without_rtk = along_a_row(learned_at(SECOND), SECOND, 290, 4.0, Code.NO_RTK)
    assert statuses(without_rtk) == {Status.ESTIMATED}
    state = learned_at(SECOND)
    without_rtk = along_a_row(state, SECOND, 310, 4.0, Code.NO_RTK)
    assert statuses(without_rtk) == {Status.STALE}
    assert sentence(without_rtk.parameters[0].reason) == "no sound data for 310 s"
    # Nobody measured what happened meanwhile: only a new window makes it fresh.
    assert statuses(along_a_row(state, 400 * SECOND, 20, 4.0, None)) == {Status.STALE}
    silent = learned_at(SECOND)
    assert statuses(along_a_row(silent, 400 * SECOND, 20, 4.0, None)) == {Status.STALE}


def test_drift_is_not_lost_when_a_fit_is_refused() -> None:
    state = learned_at(SECOND)
    state.distance, state.closed = 10_000.0, Record(0, np.zeros((10, 8)))
    before = pem.drifted(state)
    assert pem.request_fit(state, SECOND) is not None
    pem.adopt(state, MACHINE, None, 2 * SECOND)
    assert np.array_equal(state.covariance, before) and state.distance == 0.0


def test_what_the_model_of_the_ground_leaves_widens_what_is_published_and_not_the_next_fit() -> None:
    state, after, excess = pem.initial(MACHINE), pem.initial(MACHINE), np.linspace(0.0, 0.25, 6)
    state.covariance[SIX, SIX] = 1e-2 * np.eye(6)
    state.last = pem.Fit(
        state.mean, state.covariance, None, 0.0, 0.0, 0.0, 1, 9, False, False, None, Contrast(excess=excess)
    )
    state.fits, state.informed_ns = 1, 1
    published = np.reshape(pem.estimate(state, MACHINE, 2).log_covariance, (6, 6))
    assert np.diag(published) == pytest.approx(1e-2 + excess**2)
    into_pem(after, of_pem(state))
    assert np.diag(after.covariance)[SIX] == pytest.approx(1e-2 + excess**2)
    assert np.all(after.model_sd <= excess)  # so it does not average out either
