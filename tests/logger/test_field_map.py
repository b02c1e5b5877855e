"""A map of the field as what a run begins from: logged before it is used, counted once, no number."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE

from tilth.estimator import fold
from tilth.estimator.filters.soil_field import SOIL_FIELD, At, SoilWindow, Told
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem, place, tracker
from tilth.estimator.methods.place import PlaceState
from tilth.estimator.methods.tracker import USED
from tilth.estimator.warm_start import SavedPosterior, save_learned
from tilth.logger import warm_start_file
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode
from tilth.schemas.sentences import notice_sentence

SECOND = 1_000_000_000
NOW = 1_800_000_000 * SECOND
HOUR = 3600 * SECOND
ORIGIN = (43.5, -83.4)


def window(begin_ns: int, north: float, log: float = 0.2, passing: int = 3) -> SoilWindow:
    """One that knows the six to 2 %, at a place of some metres."""
    path = np.zeros((SOIL_FIELD.points, 3, 2))
    path[:, :, 0] = north + np.arange(SOIL_FIELD.points)[:, None]
    information = np.eye(6) / 0.02**2
    return SoilWindow(
        pem.METHOD, begin_ns, passing, path, Told(information, information @ np.full(6, log), np.zeros(6))
    )


def of(windows: list[SoilWindow], informed_ns: int) -> SavedPosterior:
    """What the method place keeps of these."""
    state = fold.initial(MACHINE)
    memory: PlaceState = state.estimators[place.METHOD]
    memory.windows, memory.origin_deg, memory.informed_ns = windows, ORIGIN, informed_ns
    return save_learned(MACHINE, state.estimators, informed_ns)[place.METHOD]


def with_map(path: str = "field.json") -> Machine:
    estimation = MACHINE.estimation.model_copy(update={"field_map": path})
    return MACHINE.model_copy(update={"estimation": estimation})


def test_what_the_rig_has_kept_itself_counts_beside_the_map_only_where_it_is_later() -> None:
    """A season has the same driving as the run before."""
    own, season = [window(NOW - 9 * HOUR, 0.0), window(NOW - HOUR, 50.0)], [window(NOW - 9 * HOUR, 0.0)]
    state = fold.initial(with_map())
    fold.resume(state, {place.METHOD: of(own, NOW - HOUR)}, 3600.0, NOW)
    assert fold.use_map(state, of(season, NOW - 8 * HOUR), 8 * 3600.0, NOW) is None
    memory = state.estimators[place.METHOD]
    assert len(memory.windows) == 2 and all(one.passing == -1 for one in memory.windows)
    state = fold.initial(with_map())
    fold.resume(state, {place.METHOD: of(own, NOW - HOUR)}, 3600.0, NOW)
    later = of([*season, window(NOW - HOUR, 50.0)], NOW - HOUR + 30 * SECOND)
    fold.use_map(state, later, 3570.0, NOW)
    assert len(state.estimators[place.METHOD].windows) == 2


def at_place(north: float, windows: list[SoilWindow]) -> tuple[fold.State, At | None]:
    state = fold.initial(with_map())
    fold.use_map(state, of(windows, NOW - HOUR), 0.0, NOW)
    memory = state.estimators[place.METHOD]
    memory.axles = np.array([[north, 0.0]] * 3)
    return state, place.by_earlier_runs(memory)


def test_a_place_outside_of_the_map_has_no_prior() -> None:
    windows = [window(NOW - HOUR, 10.0 * k) for k in range(8)]
    assert at_place(40.0, windows)[1] is not None
    assert at_place(2000.0, windows)[1] is None


def test_the_tracker_begins_with_the_map_and_has_no_number_of_it() -> None:
    """Before today's data nothing is known of today, however sure the map is."""
    windows = [window(NOW - HOUR, 10.0 * k) for k in range(8)]
    state, there = at_place(40.0, windows)
    assert there is not None
    ours, fresh = state.estimators[tracker.METHOD], fold.initial(MACHINE).estimators[tracker.METHOD]
    tracker.expect(ours, there, NOW - HOUR)
    assert ours.mean[SIX] == pytest.approx(fresh.mean[SIX] + there.mean)
    assert np.all(np.diag(ours.covariance)[:3] < np.diag(fresh.covariance)[:3] / 4)
    ours.informed_ns = NOW  # a first segment of today, that told nothing
    told = tracker.estimate(ours, MACHINE, NOW + SECOND)
    assert all(one.value is None for one in told.parameters)
    assert told.excitation["map_age_s"] == pytest.approx(3601.0)
    reported = np.reshape(told.log_covariance, (6, 6))
    assert np.all(np.sqrt(np.diag(reported)[:3]) < np.sqrt(np.diag(fresh.covariance)[:3]) / 2)


def test_later_it_follows_how_soil_differs_and_learns_nothing_of_it() -> None:
    windows = [window(NOW - HOUR, 10.0 * k, 0.2 if k < 4 else -0.2) for k in range(8)]
    state, here = at_place(0.0, windows)
    there = at_place(75.0, windows)[1]
    assert here is not None and there is not None
    ours = state.estimators[tracker.METHOD]
    tracker.expect(ours, here, NOW)
    before, covariance = ours.mean.copy(), ours.covariance.copy()
    ours.counts[USED] = 100.0
    tracker.expect(ours, there, NOW)
    assert ours.mean[SIX] - before[SIX] == pytest.approx(there.mean - here.mean)
    assert there.mean[0] - here.mean[0] < -0.2
    assert np.array_equal(ours.covariance, covariance)
    late = fold.initial(with_map()).estimators[tracker.METHOD]
    late.counts[USED] = 100.0  # it has learned elsewhere today
    tracker.expect(late, here, NOW)
    assert late.map_mean is None


def taken_up(machine: Machine, folder: Path) -> tuple[GuardedFold, bool, list[Notice]]:
    guarded, told = GuardedFold(machine), list[Notice]()
    used = warm_start_file.take_up(
        folder / "none.warm.json", machine, NOW, guarded.warm, lambda kind, notice: told.append(notice)
    )
    return guarded, used, told


def test_the_daemon_begins_with_the_map_which_is_then_in_the_state_that_it_logs(tmp_path: Path) -> None:
    path, machine = tmp_path / "field.json", with_map(str(tmp_path / "field.json"))
    learned = {place.METHOD: of([window(NOW - HOUR, 10.0 * k) for k in range(8)], NOW - HOUR)}
    path.write_text(warm_start_file.text_of(MACHINE, learned, NOW - HOUR))
    guarded, used, told = taken_up(machine, tmp_path)
    assert used and [one.code for one in told] == [NoticeCode.FIELD_MAP]
    assert "1.0 h ago" in notice_sentence(told[0])
    logged = guarded.renew()
    again = GuardedFold(machine, logged)
    assert again.renew() == logged and len(again.state.estimators[place.METHOD].windows) == 8
    moved = replace_mass(machine)
    assert "[tractor]" in notice_sentence(taken_up(moved, tmp_path)[2][0])


def replace_mass(machine: Machine) -> Machine:
    mass = machine.tractor.mass.model_copy(update={"value": machine.tractor.mass.value + 500.0})
    return machine.model_copy(update={"tractor": machine.tractor.model_copy(update={"mass": mass})})


@pytest.mark.parametrize("text", [None, "", "{}", '{"format": 0}', "[" * 5000])
def test_a_map_that_cannot_be_used_is_told_and_the_run_begins(text: str | None, tmp_path: Path) -> None:
    path = tmp_path / "field.json"
    if text is not None:
        path.write_text(text)
    _, used, told = taken_up(with_map(str(path)), tmp_path)
    assert not used and [one.code for one in told] == [NoticeCode.LEARNED_REFUSED]
    assert str(path) in notice_sentence(told[0])


def test_a_map_of_numbers_that_are_none_is_refused() -> None:
    bad = window(NOW - HOUR, 0.0)
    bad = replace(bad, told=replace(bad.told, vector=np.full(6, np.nan)))
    state = fold.initial(with_map())
    assert fold.use_map(state, of([bad], NOW), 0.0, NOW) is not None
    assert not state.estimators[place.METHOD].windows
