"""The memory by place: what it takes from fits of others, where, and what of it is stored."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from circle import demo_machine
from numpy.typing import NDArray

from tilth.client.received import estimate_of
from tilth.estimator import fold
from tilth.estimator.filters import soil_field
from tilth.estimator.filters.soil_field import Told
from tilth.estimator.methods import pem, place, rows
from tilth.estimator.methods.place import PLACE, PlaceState
from tilth.estimator.pose.geometry import to_degrees, to_plane
from tilth.estimator.record.record import Record
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import BodyPose, Estimate, Event, EventKind, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import notice_sentence

MACHINE = demo_machine()
S = 1_000_000_000
ORIGIN = (43.5, -83.4)


def pose_at(t_ns: int, north: float, east: float = 0.0, heading: float = 0.0) -> Pose:
    sds = (0.02, heading, 0.005, 4.0, 0.0, 0.03, 0.04, 0.0, 0.003, 0.0, 0.004)
    behind = 5.8 * math.cos(heading)
    tractor, implement = BodyPose(north, east, *sds), BodyPose(north - behind, east, *sds)
    return Pose(t_ns, *ORIGIN, tractor, implement, 0.0, 0.007, 0.0, 0.002, 1, None, 0.0, 4, ())


def drive(
    state: PlaceState, t_ns: int, north: float, east: float = 0.0, metres: float = 60.0, heading: float = 0.0
) -> Estimate:
    """On from there at 4 m/s; the last estimate."""
    last, ahead = None, math.cos(heading)
    for k in range(round(metres / 0.8)):
        pose = pose_at(t_ns + k * S // 5, north + 0.8 * k * ahead, east, heading)
        last = place.take(state, MACHINE, pose, None) or last
    assert last is not None
    return last


def fit_of(
    state: PlaceState, t_ns: int, seconds: float, log: float, sd: float, changed: bool = False
) -> tuple[pem.Job, pem.Fit]:
    """A window of pem that says so of the stiffnesses, and that lengths are as the file has them."""
    information = np.eye(6) / sd**2
    record = Record(t_ns, np.zeros((round(seconds * 50), 8)))
    mean, prior_sd = state.prior_mean, state.prior_sd
    job = pem.Job(record.end_ns, record.end_ns, record, mean, np.diag(prior_sd**2))
    told = Told(information, information @ np.repeat([log, 0.0], 3), np.zeros(6))
    return job, pem.Fit(mean, job.covariance, told, 0.0, 0.0, 0.0, 1, 9, changed, False, None)


def fitted(state: PlaceState, t_ns: int, seconds: float, log: float, sd: float = 0.05) -> bool:
    return place.learn(state, *fit_of(state, t_ns, seconds, log, sd))


def to_and_fro(state: PlaceState, wet: float, passes: int) -> list[bool]:
    """Windows at both ends of passes six metres apart; the further one is softer."""
    foreseen = []
    for k in range(2 * passes):
        t_ns = (10 + 100 * k) * S
        drive(state, t_ns, 200.0 * (k % 2), 6.0 * (k // 2))
        foreseen.append(fitted(state, t_ns, 14.0, wet * (k % 2)))
    return foreseen


def sds(estimate: Estimate) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.diag(np.reshape(estimate.log_covariance, (6, 6)))))


def test_a_number_is_of_the_place_where_the_rig_is() -> None:
    state = place.initial(MACHINE)
    nothing = drive(state, 10 * S, 0.0)
    assert {p.reason.code for p in nothing.parameters if p.reason} == {Code.NOTHING_FITTED}
    assert nothing.of_place is None
    fitted(state, 10 * S, 14.0, -0.3)
    here = place.estimate(state, MACHINE, 30 * S)
    assert all(p.status is Status.ESTIMATED for p in here.parameters) and here.of_place is not None
    assert np.log([p.value or math.nan for p in here.parameters]) - state.prior_mean[:6] == pytest.approx(
        np.repeat([-0.3, 0.0], 3), abs=0.1
    )
    away = drive(state, 40 * S, 200.0)  # with nothing learned on the way
    assert np.all(sds(away)[:3] > 1.3 * sds(here)[:3]) and np.allclose(sds(away)[3:], sds(here)[3:], rtol=0.1)
    assert away.of_place is not None and here.of_place.prior < away.of_place.prior


def test_the_second_pass_knows_the_wet_end_before_it_gets_there() -> None:
    state = place.initial(MACHINE)
    for k, (north, log) in enumerate([(0.0, 0.0), (200.0, -0.4)]):
        drive(state, (10 + 100 * k) * S, north)
        fitted(state, (10 + 100 * k) * S, 14.0, log)
    back = drive(state, 300 * S, 190.0, 6.0, 160.0, math.pi)  # on the next pass, from the wet end
    assert back.of_place is not None and back.of_place.neighbours > back.of_place.this_pass
    axles = place.axles_ahead(state, MACHINE, 225.0, 6.0)
    there = place.estimate_at(state, MACHINE, 400 * S, axles, [False] * 6)
    dry = place.estimate_at(
        state, MACHINE, 400 * S, place.axles_ahead(state, MACHINE, 25.0, 6.0), [False] * 6
    )
    values = [np.log([p.value or math.nan for p in one.parameters[:3]]) for one in (dry, there)]
    assert values[1] - values[0] == pytest.approx(np.full(3, -0.4), abs=0.15)
    assert np.all(sds(there)[:3] < 0.3)


def test_what_is_recommended_away_from_its_window_is_as_wide_as_soil_may_differ() -> None:
    state = fold.initial(MACHINE)
    memory, found = state.estimators["place"], state.estimators["pem"]

    def widened(t_ns: int, north: float) -> float:
        drive(memory, t_ns, north, metres=14.0)
        known = fold.estimates_now(state)
        before, after = (sds(known[method]) for method in ("pem", "recommended"))
        assert after[3:] == pytest.approx(before[3:])
        return float(np.sqrt(np.mean(after[:3] ** 2 - before[:3] ** 2)))

    assert widened(2 * S, 0.0) == 0.0  # before any window pem has nothing to say
    for k, (north, alike) in enumerate([(0.0, False), *[(200.0 * (k % 2), True) for k in range(1, 12)]]):
        t_ns = (10 + 100 * k) * S
        drive(memory, t_ns, north, 6.0 * k, metres=14.0)
        found.job, made = fit_of(memory, t_ns, 14.0, 0.02 * (-1) ** k, 0.05)
        covariance = np.diag(np.where(np.arange(len(made.mean)) < 6, 0.05**2, np.diag(made.covariance)))
        fold.adopt(state, t_ns + 20 * S, "pem", replace(made, covariance=covariance))
        if not alike:
            near, far = widened(t_ns + 30 * S, 7.0), widened(t_ns + 50 * S, 200.0)
            assert near < 0.17 < 0.2 < far
    assert widened(2000 * S, 100.0) < 0.05  # what is the same at both ends for so long is so between them


def test_a_block_that_is_fitted_again_counts_once() -> None:
    state = place.initial(MACHINE)
    drive(state, 10 * S, 0.0)
    fitted(state, 10 * S, 10.0, 0.1)
    once = place.estimate(state, MACHINE, 30 * S)
    fitted(state, 10 * S, 10.0, 0.1)
    assert len(state.windows) == 1
    assert sds(place.estimate(state, MACHINE, 30 * S)) == pytest.approx(sds(once))


@pytest.mark.parametrize("first", ["rows", "pem"])
@pytest.mark.parametrize(("begins_s", "left"), [(-5.0, 2), (0.0, 1), (60.0, 1), (100.0, 1), (115.0, 2)])
def test_a_second_of_driving_informs_once_in_a_row_by_rows(begins_s: float, left: int, first: str) -> None:
    """What pem told of the same driving goes, also where it is told later, as its window reaches over the end
    of the row's block; of turns before and after it stays."""
    state = place.initial(MACHINE)
    row = Record(20 * S, np.zeros((6000, 8)))
    drive(state, 10 * S, 0.0, metres=600.0)
    mean, known = state.prior_mean, np.diag(state.prior_sd**2)
    told = Told(100.0 * np.eye(6), np.zeros(6), np.zeros(6))
    job = rows.Job(row.end_ns, row.end_ns, [row], True, mean, known)
    pieces = (rows.ToldPiece(row.t_ns, row.end_ns, told),)
    made = rows.Fit(mean, known, 0.9, 0.01, 110.0, 5, -6.0, False, False, None, told, pieces=pieces)
    if first == "rows":
        place.learn(state, job, made)
    fitted(state, row.t_ns + round(begins_s * S), 14.0, 0.3)
    if first == "pem":
        place.learn(state, job, made)
    assert len(state.windows) == left and any(window.method == rows.METHOD for window in state.windows)


def test_pieces_of_a_block_are_told_again_with_it_and_lose_nothing() -> None:
    """Of a block that is fitted twice, and of the next one, in more pieces than are kept."""
    state = place.initial(MACHINE)
    mean, known = state.prior_mean, np.diag(state.prior_sd**2)
    for k in range(12):
        drive(state, (10 + 100 * k) * S, 0.0, 6.0 * k, 320.0)
    row_of = [Record((10 + 100 * k) * S, np.zeros((4000, 8))) for k in range(12)]
    for first, last in ((0, 3), (0, 8), (8, 12)):
        records = row_of[first:last]
        told = Told(np.eye(6), np.zeros(6), np.zeros(6))
        begins = [record.t_ns + 10 * S * k for record in records for k in range(8)]
        pieces = tuple(rows.ToldPiece(begin_ns, begin_ns + 10 * S, told) for begin_ns in begins)
        job = rows.Job(records[-1].end_ns, records[-1].end_ns, records, last == 8, mean, known)
        made = rows.Fit(mean, known, 0.9, 0.01, 110.0, 5, -6.0, False, False, None, told, pieces=pieces)
        place.learn(state, job, made)
        assert len(state.windows) <= PLACE.most_windows
        total = sum(window.told.information[0, 0] for window in state.windows)
        assert total == pytest.approx(8 * last)
    ends = np.array([window.path[:, 1, 0].mean() for window in state.windows])
    assert np.ptp(ends) > 200.0  # in place


def test_it_is_bounded_and_the_nearest_become_one() -> None:
    state = place.initial(MACHINE)
    for k in range(PLACE.most_windows + 5):
        t_ns = (10 + 100 * k) * S
        drive(state, t_ns, 200.0 * (k % 2), 6.0 * (k // 2), 20.0)
        fitted(state, t_ns, 5.0, 0.1)
    assert len(state.windows) == PLACE.most_windows and len(state.track) <= PLACE.track
    total = sum(window.told.information[0, 0] for window in state.windows)
    assert total == pytest.approx((PLACE.most_windows + 5) / 0.05**2)


def test_another_origin_of_the_plane_moves_no_place() -> None:
    state = place.initial(MACHINE)
    drive(state, 10 * S, 0.0)
    fitted(state, 10 * S, 14.0, -0.3)
    before = place.estimate(state, MACHINE, 30 * S)
    moved = replace(pose_at(31 * S, -52.0 - 100.0), origin_latitude_deg=ORIGIN[0] + 0.001)
    shift = to_plane((ORIGIN[0] + 0.001, ORIGIN[1]), *to_degrees(ORIGIN, 59.2, 0.0))
    bodies = [replace(body, x=shift[0] - behind, y=shift[1]) for body, behind in
              ((moved.tractor, 0.0), (moved.implement, 5.8))]  # fmt: skip
    place.take(state, MACHINE, replace(moved, tractor=bodies[0], implement=bodies[1]), None)
    after = place.estimate(state, MACHINE, 31 * S)
    assert sds(after) == pytest.approx(sds(before), rel=1e-3)


def test_what_was_learned_on_the_other_side_of_the_earth_is_of_no_use_here() -> None:
    state = place.initial(MACHINE)
    drive(state, 10 * S, 0.0)
    fitted(state, 10 * S, 14.0, -0.3)
    there = replace(pose_at(60 * S, 0.0), origin_latitude_deg=-43.5, origin_longitude_deg=96.6)
    told = place.take(state, MACHINE, there, None)
    assert told is not None and np.all(np.isfinite(told.log_covariance))


def test_stored_and_restored_it_goes_on_to_the_byte() -> None:
    state = place.initial(MACHINE)
    drive(state, 10 * S, 0.0)
    fitted(state, 10 * S, 14.0, -0.3)
    drive(state, 60 * S, 100.0)  # what is derived has been derived
    again = from_json_data(PlaceState, json.loads(json.dumps(to_json_data(state))))
    for one in (state, again):
        fitted(one, 60 * S, 14.0, 0.1)
    channel = CHANNEL["/soil_tire/place"]
    told = [channel.encode(drive(one, 200 * S, 0.0, 6.0)) for one in (state, again)]
    assert told[0] == told[1]
    heard = estimate_of(told[0], channel.encoding)
    assert heard.of_place is not None
    assert heard.of_place.this_pass + heard.of_place.neighbours + heard.of_place.prior == pytest.approx(1.0)


def test_a_way_that_is_not_known_tells_of_no_place() -> None:
    state = place.initial(MACHINE)
    fitted(state, 10 * S, 14.0, -0.3)
    assert state.windows == [] and soil_field.SOIL_FIELD.points > 1


def test_what_another_thread_derives_of_before_is_not_taken_for_now() -> None:
    """It asked for a place ahead, and was done after the next window had been learned."""
    state, alone = place.initial(MACHINE), place.initial(MACHINE)
    for one in (state, alone):
        drive(one, 10 * S, 0.0)
        fitted(one, 10 * S, 14.0, -0.3)
    place.estimate(state, MACHINE, 30 * S)
    late = state.soil
    for one in (state, alone):
        drive(one, 40 * S, 60.0)
        fitted(one, 40 * S, 14.0, 0.2)
    state.soil = late
    assert place.estimate(state, MACHINE, 60 * S) == place.estimate(alone, MACHINE, 60 * S)


def passes(state: PlaceState, machine: Machine, first: int, count: int, length: float = 160.0) -> None:
    """To and fro, six metres apart."""
    for k in range(first, first + count):
        up = k % 2 == 0
        for step in range(round(length / 0.8)):
            north = 0.8 * step if up else length - 0.8 * step
            pose = pose_at((1000 * k + step) * S // 5, north, 6.0 * (k % 4), 0.0 if up else math.pi)
            place.take(state, machine, pose, None)


def test_ground_is_worked_where_the_implement_went_in_a_pass_before() -> None:
    section = MACHINE.implement.model_copy(update={"working_width": 6.0})
    machine, state = MACHINE.model_copy(update={"implement": section}), place.initial(MACHINE)
    passes(state, machine, 0, 4)
    assert not np.any([point.worked for point in state.track])  # nor where the rows touch
    assert len(state.way) < 20  # corners only
    passes(state, machine, 4, 1)  # once more over the first
    shares = [point.worked for point in state.track]
    assert np.mean(shares[-15:]) > 0.9
    beside, on, own = (
        place.worked(state, machine, np.tile([80.0, east], (3, 1))) for east in (2.0, -3.5, 300.0)
    )
    assert np.all(beside == 1.0) and not on.any() and not own.any()
    assert not place.worked(place.initial(MACHINE), machine, np.zeros((3, 2))).any()
    again = from_json_data(PlaceState, to_json_data(state))
    for one in (state, again):  # it goes on as it was
        passes(one, machine, 5, 1)
    assert to_json_data(again) == to_json_data(state)


def test_a_number_of_worked_ground_comes_from_worked_ground() -> None:
    """What is known of ground that has not been worked is less sure on ground that has."""
    section = MACHINE.implement.model_copy(update={"working_width": 6.0})
    machine, state = MACHINE.model_copy(update={"implement": section}), place.initial(MACHINE)
    passes(state, machine, 0, 2)
    t_ns = state.track[-1].t_ns
    state.track.clear()
    drive(state, t_ns, 60.0, 60.0)
    fitted(state, t_ns, 14.0, -0.3)
    assert not state.windows[0].worked.any()
    wide = []
    for width in (0.0, 6.0):
        section = section.model_copy(update={"working_width": width})
        machine = MACHINE.model_copy(update={"implement": section})
        axles = np.tile([80.0, 0.0], (3, 1))
        wide.append(sds(place.estimate_at(state, machine, t_ns, axles, [False] * 6)))
    assert np.all(wide[1][:3] > np.hypot(wide[0][:3], 0.19)) and wide[1][3:] == pytest.approx(wide[0][3:])


def test_a_clock_that_steps_back_leaves_windows_as_old_as_they_were() -> None:
    state = place.initial(MACHINE)
    drive(state, 9000 * S, 0.0)
    fitted(state, 9000 * S, 14.0, -0.3)
    axles = np.tile([20.0, 0.0], (3, 1))
    before = place.estimate_at(state, MACHINE, 19000 * S, axles, [False] * 6)
    place.clock_stepped(state, -8000 * S)
    after = place.estimate_at(state, MACHINE, 11000 * S, axles, [False] * 6)
    assert sds(after) == pytest.approx(sds(before))


def test_from_the_third_pass_on_the_wet_end_is_foreseen_and_rain_is_not() -> None:
    state = place.initial(MACHINE)
    foreseen = to_and_fro(state, -0.5, 5)
    assert not any(foreseen[:2]) and all(foreseen[4:]) and state.events == []
    drive(state, 2000 * S, 0.0, 33.0)
    assert not fitted(state, 2000 * S, 14.0, -0.8)
    assert [kind for kind, _ in state.events] == [EventKind.SOIL_CHANGE]
    assert "C_af × 0.39 to 0.5" in notice_sentence(state.events[0][1])
    here = place.estimate(state, MACHINE, 2060 * S)  # what was known of the level before does not hold it
    logs = np.log([p.value or math.nan for p in here.parameters[:3]]) - state.prior_mean[:3]
    assert logs == pytest.approx(np.full(3, -0.8), abs=0.15)
    assert fitted(state, 2000 * S, 14.0, -0.8) is False and len(state.events) == 2  # the same block again
    assert max(window.epoch for window in state.windows) == 1


@pytest.mark.parametrize("patches", [0.0, 0.25])
def test_a_field_in_which_nothing_changes_in_time_has_no_event(patches: float) -> None:
    rng, state = np.random.default_rng(3), place.initial(MACHINE)
    soil = patches * rng.standard_normal(2)
    for k in range(16):
        t_ns = (10 + 100 * k) * S
        drive(state, t_ns, 200.0 * (k % 2), 6.0 * (k // 2), 20.0)
        fitted(state, t_ns, 5.0, soil[k % 2] + 0.05 * rng.standard_normal(), 0.1)
        if k % 2:  # on to the next pass
            soil = 0.8 * soil + 0.6 * patches * rng.standard_normal(2)
    assert state.events == []


@pytest.mark.parametrize("north", [0.0, 200.0])
def test_what_a_method_finds_is_expected_where_the_place_is_known_and_alike(north: float) -> None:
    state, wet = place.initial(MACHINE), -0.5
    logs = state.prior_mean.copy()
    assert not place.expects(state, logs)
    to_and_fro(state, wet, 5)
    drive(state, 2000 * S, north, 33.0, 14.0)
    logs[:3] += wet * (north > 0.0)
    assert place.expects(state, logs)
    assert not place.expects(state, logs - 0.8)
    state.windows = state.windows[:2]  # after the first pass
    drive(state, 2100 * S, 100.0, 33.0, 14.0)
    assert not place.expects(state, logs)


@pytest.mark.parametrize(("log", "told"), [(-0.5, 0), (0.8, 1)])
def test_the_fold_tells_of_a_change_of_soil_that_the_memory_did_not_foresee(log: float, told: int) -> None:
    state = fold.initial(MACHINE)
    state.diagnosis.consistency.confirmed = True
    memory, found = state.estimators["place"], state.estimators["pem"]
    to_and_fro(memory, -0.5, 5)
    drive(memory, 2000 * S, 200.0, 33.0)
    found.job, made = fit_of(memory, 2000 * S, 14.0, log, 0.05, True)
    kinds = [p.value.kind for p in fold.adopt(state, 2100 * S, "pem", made) if isinstance(p.value, Event)]
    assert kinds.count(EventKind.SOIL_CHANGE) == told
    assert found.changes == 1  # pem learns anew either way


def test_windows_of_before_and_after_a_change_in_time_become_one_last() -> None:
    """Where the same rows are driven again after rain, the nearest window is of dry soil."""
    told = Told(np.eye(6), np.zeros(6), np.zeros(6))
    windows = [
        soil_field.SoilWindow("pem", k, 0, np.tile([60.0 * (k % 3), 0.0], (6, 3, 1)), told, epoch=k // 3)
        for k in range(7)
    ]
    for left, epochs in ((6, 3), (5, 3), (4, 3), (3, 3), (2, 2)):
        windows = place.merged_nearest(windows)
        assert len(windows) == left and len({window.epoch for window in windows}) == epochs
