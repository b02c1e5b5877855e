"""What one run has learned, in the next: older, of the same rig, and in the log before it is used."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from logs import MACHINE, MACHINE_TEXT
from loopback import rig
from verified import verified

from tilth.estimator import fold
from tilth.estimator.diagnosis.information import InformationForm
from tilth.estimator.diagnosis.watch import Moved
from tilth.estimator.filters import soil_field, unknowns
from tilth.estimator.fold import resume, save_learned
from tilth.estimator.methods import pem, place, rows, steady_state, tracker
from tilth.estimator.methods.estimators import ESTIMATORS, ROW
from tilth.estimator.rig.lifecycle import FaultCase
from tilth.estimator.rig.numbers import WHEEL
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.warm_start import WARM_START
from tilth.logger import warm_start_file
from tilth.logger.clock import Clock
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.warm_start_file import CLOCK_IS_WRONG_S, NotUsable
from tilth.replay.readers.any_log import open_log
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.flow import Accepted, Event, Frame, Status
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto.tilth_pb2 import Snapshot
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import event_sentence, sentence
from tilth.simulator.scenario import ORIGIN_DEG
from tilth.simulator.traffic import simulate

SECOND = 1_000_000_000
NOW = 1_800_000_000 * SECOND
VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-warm"\n\n'


def teach(state: fold.State, informed_ns: int) -> None:
    """As if all methods had learned something by then."""
    rng = np.random.default_rng(2)
    for method in (pem.METHOD, rows.METHOD, tracker.METHOD, steady_state.METHOD):
        ours, memory = state.estimators[method], ROW[method].memory
        assert memory is not None
        known = memory.learned(ours)
        sd = np.sqrt(np.diag(known.covariance))
        root = 0.1 * sd[:, None] * rng.normal(size=(len(sd), len(sd))) / np.sqrt(len(sd))
        covariance = root @ root.T + np.diag((0.01 * sd) ** 2)
        memory.resume(ours, replace(known, mean=known.mean + 0.1 * sd, covariance=covariance))
        ours.informed_ns = informed_ns
    memory_of_place = state.estimators[place.METHOD]
    memory_of_place.origin_deg, memory_of_place.informed_ns = (43.5, -83.4), informed_ns
    path = rng.normal(size=(soil_field.SOIL_FIELD.points, 3, 2))
    known_now = soil_field.Told(100.0 * np.eye(6), rng.normal(size=6), np.full(6, 0.1))
    memory_of_place.windows = [soil_field.SoilWindow(pem.METHOD, 0, 3, path, known_now)]
    state.diagnosis.consistency.confirmed = True
    state.estimators[pem.METHOD].fits = 3
    state.estimators[pem.METHOD].window_s = 90.0
    state.estimators[pem.METHOD].model_sd = np.array([0.02, 0.02, 0.03, 0.05, 0.05, 0.05]) / 10.0
    state.estimators[steady_state.METHOD].steady_s = 12.0
    state.estimators[steady_state.METHOD].largest_angle = 0.5


def taught() -> fold.State:
    state = fold.initial(MACHINE)
    teach(state, NOW - 5 * SECOND)
    return state


def sds(state: fold.State) -> np.ndarray[Any, np.dtype[np.float64]]:
    found: np.ndarray[Any, np.dtype[np.float64]] = np.sqrt(np.diag(state.estimators[pem.METHOD].covariance))
    return found


# Growing older


@pytest.mark.parametrize("row", [row for row in ESTIMATORS if row.memory], ids=lambda row: row.method)
def test_what_is_kept_at_once_goes_on_as_it_was(row: Any) -> None:
    before, after = taught(), fold.initial(MACHINE)
    assert resume(after, save_learned(before, NOW), 0.0, NOW)[row.method] is None
    memory, old, new = row.memory, before.estimators[row.method], after.estimators[row.method]
    assert new.informed_ns == old.informed_ns
    stays = [k for k, name in enumerate(memory.names) if name not in memory.per_run]
    learned, fresh = memory.learned(new), memory.learned(row.initial(MACHINE))
    assert learned.mean[stays] == pytest.approx(memory.learned(old).mean[stays], abs=1e-9)
    assert learned.counts == memory.learned(old).counts
    for name in memory.per_run:
        k = memory.names.index(name)
        assert learned.covariance[k, k] == pytest.approx(fresh.covariance[k, k])
    assert from_json(after) == after.estimators.keys()


def from_json(state: fold.State) -> Any:
    return restore(MACHINE, snapshot(state)).estimators.keys()


def test_what_was_learned_while_the_machine_file_is_in_doubt_is_not_kept() -> None:
    state = taught()
    state.diagnosis.consistency.confirmed = False
    assert save_learned(state, NOW) == {}


def test_what_was_kept_was_confirmed() -> None:
    state = fold.initial(MACHINE)
    resume(state, {}, 0.0, NOW)
    assert not state.diagnosis.consistency.confirmed
    resume(state, save_learned(taught(), NOW), 0.0, NOW)
    assert state.diagnosis.consistency.confirmed


def test_a_sd_doubles_in_a_day_and_ends_at_the_prior() -> None:
    retained = save_learned(taught(), NOW)
    six = sds(taught())[unknowns.SIX]
    aged = []
    for seconds in (0.0, WARM_START.doubles_s, 2.0 * WARM_START.doubles_s, 100.0 * WARM_START.doubles_s):
        state = fold.initial(MACHINE)
        resume(state, retained, seconds, NOW)
        aged.append(sds(state)[unknowns.SIX])
    assert aged[0] == pytest.approx(six, rel=1e-6)
    assert np.all(aged[1] < 2.0 * six) and np.all(aged[1] > 1.3 * six)
    assert np.all(aged[2] > aged[1])
    prior = sds(fold.initial(MACHINE))[unknowns.SIX]
    assert aged[3] == pytest.approx(prior)
    assert state.estimators[pem.METHOD].mean == pytest.approx(unknowns.prior(MACHINE)[0])


def test_a_pair_that_comes_back_after_a_week_begins_where_it_was_left(tmp_path: Path) -> None:
    """As wide as the fading says, whatever another implement has learned meanwhile."""
    parker, other = (
        MACHINE.model_copy(update={"implement": MACHINE.implement.model_copy(update={"name": name})})
        for name in ("parker", "other")
    )
    week = 7 * 86_400 * SECOND
    for machine, t_ns in ((parker, NOW), (other, NOW + week // 2)):
        text = warm_start_file.text_of(machine, save_learned(taught(), NOW), t_ns)
        warm_start_file.path_of(tmp_path, machine).write_text(text)
    found = warm_start_file.read(warm_start_file.path_of(tmp_path, parker), parker, NOW + week)
    assert found is not None and found.elapsed_s == pytest.approx(week * 1e-9)
    state, memory = fold.initial(parker), ROW[tracker.METHOD].memory
    assert memory is not None
    fresh = memory.learned(state.estimators[tracker.METHOD])
    assert not any(resume(state, found.learned, found.elapsed_s, NOW + week).values())
    left, now = (memory.learned(one.estimators[tracker.METHOD]) for one in (taught(), state))
    share = 4.0 ** (-week * 1e-9 / WARM_START.doubles_s)
    six = unknowns.SIX
    before, wide = np.diag(left.covariance)[six], np.diag(fresh.covariance)[six]
    assert np.all(np.diag(now.covariance)[six] > before) and np.all(np.diag(now.covariance)[six] <= wide)
    assert np.all(np.diag(now.covariance)[six] > wide / (1.0 + share * (wide / before).max() * 10.0))
    moved, was = (now.mean - fresh.mean)[six], (left.mean - fresh.mean)[six]
    assert np.all(np.abs(moved) <= np.abs(was) + 1e-9)  # between it and the prior


def test_what_windows_told_of_a_place_ages_and_is_of_no_pass_of_this_run() -> None:
    state, kept = fold.initial(MACHINE), save_learned(taught(), NOW)
    resume(state, kept, WARM_START.doubles_s, NOW)
    (before,), (after,) = (each.estimators[place.METHOD].windows for each in (taught(), state))
    assert np.array_equal(after.told.information, before.told.information) and after.passing == -1
    assert before.begin_ns - after.begin_ns == round(1e9 * WARM_START.doubles_s)
    assert np.array_equal(after.path, before.path)
    axles = before.path[0]
    long_ago = fold.initial(MACHINE)
    resume(long_ago, kept, 100.0 * WARM_START.doubles_s, NOW)
    now = place.estimate_at(long_ago.estimators[place.METHOD], MACHINE, NOW, axles, [False] * 6)
    assert all(p.value is None for p in now.parameters)


def test_a_scalar_fades_by_the_formula() -> None:
    state = taught()
    ours = state.estimators[pem.METHOD]
    ours.covariance = np.diag((0.1 * sds(fold.initial(MACHINE))) ** 2)
    retained, after = save_learned(state, NOW), fold.initial(MACHINE)
    resume(after, retained, WARM_START.doubles_s, NOW)
    prior = ours.prior_sd[0]
    assert sds(after)[0] == pytest.approx(prior / np.sqrt(0.25 * 100.0 + 0.75))


def test_a_number_of_yesterday_is_stale_and_as_old_as_it_is() -> None:
    state = fold.initial(MACHINE)
    resume(state, save_learned(taught(), NOW), 36_000.0, NOW)
    given = pem.estimate(state.estimators[pem.METHOD], MACHINE, NOW).parameters[0]
    assert given.status is Status.STALE
    assert given.value is not None
    assert given.age_s == pytest.approx(36_005.0)


def test_nothing_learned_is_nothing_kept() -> None:
    assert save_learned(fold.initial(MACHINE), NOW) == {}


SPOILT: tuple[tuple[dict[str, Any], Code], ...] = (
    ({"names": ("C_af",)}, Code.SAVED_BY_ANOTHER_VERSION),
    ({"mean": np.zeros(3)}, Code.SAVED_BY_ANOTHER_VERSION),
    ({"mean": np.full(len(unknowns.NAMES), np.nan)}, Code.SAVED_NOT_FINITE),
    ({"covariance": -np.eye(len(unknowns.NAMES))}, Code.SAVED_WITHOUT_COVARIANCE),
    ({"counts": {}}, Code.SAVED_INCOMPLETE),
    ({"age_s": np.nan}, Code.SAVED_INCOMPLETE),
)


@pytest.mark.parametrize(("change", "expected"), SPOILT)
def test_what_is_spoilt_is_not_used(change: dict[str, Any], expected: Code) -> None:
    retained = save_learned(taught(), NOW)
    state = fold.initial(MACHINE)
    why_not = resume(state, {**retained, "pem": replace(retained["pem"], **change)}, 0.0, NOW)
    assert why_not["pem"] is expected
    assert why_not["steady_state"] is None
    assert np.array_equal(state.estimators["pem"].mean, fold.initial(MACHINE).estimators["pem"].mean)


# The file


def stored(tmp_path: Path) -> Path:
    path = warm_start_file.path_of(tmp_path, MACHINE)
    path.write_text(warm_start_file.text_of(MACHINE, save_learned(taught(), NOW), NOW))
    return path


def test_the_file_gives_back_to_the_bit_what_was_written(tmp_path: Path) -> None:
    path = stored(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [f"{MACHINE.name}.warm.json"]
    found = warm_start_file.read(path, MACHINE, NOW + 7 * SECOND)
    assert found is not None
    retained, elapsed_s = found.learned, found.elapsed_s
    assert elapsed_s == 7.0
    for method, wanted in save_learned(taught(), NOW).items():
        assert retained[method].mean.tobytes() == wanted.mean.tobytes()
        assert retained[method].covariance.tobytes() == wanted.covariance.tobytes()


def test_no_file_is_nothing_and_a_clock_that_went_back_is_a_day(tmp_path: Path) -> None:
    assert warm_start_file.read(tmp_path / "x.warm.json", MACHINE, NOW) is None
    found = warm_start_file.read(stored(tmp_path), MACHINE, NOW - 1)
    assert found is not None and found[1] == CLOCK_IS_WRONG_S


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("mass = 9391.0", "mass = 9400.0", "[tractor] of the machine file changed"),
        ("mass = { value = 2127.0", "mass = { value = 2500.0", "[implement] of the machine file changed"),
        ("cornering_stiffness = 220e3", "cornering_stiffness = 230e3", "[tyres] of the machine file changed"),
        ('prefix = "tilth"', 'prefix = "other"', ""),
    ],
)
def test_what_was_learned_belongs_to_one_rig(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = MACHINE_TEXT.replace(old, new, 1)
    assert text != MACHINE_TEXT
    path = stored(tmp_path)
    if not expected:
        assert warm_start_file.read(path, parse_machine(text), NOW) is not None
        return
    with pytest.raises(NotUsable) as caught:
        warm_start_file.read(path, parse_machine(text), NOW)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        lambda plain: {**plain, "format": warm_start_file.FORMAT + 1},
        lambda plain: {k: v for k, v in plain.items() if k != "sections"},
        lambda plain: {**plain, "methods": {"pem": {"mean": 5}}},
        lambda plain: {**plain, "methods": []},
        lambda plain: {**plain, "utc_ns": "soon"},
        lambda plain: {**plain, "moved": [{"names": ["wheel_angle"]}]},
        lambda plain: [],
    ],
)
def test_a_file_that_is_none_is_told(tmp_path: Path, change: Any) -> None:
    path = stored(tmp_path)
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(NotUsable, match=r"damaged|another version|another kind"):
        warm_start_file.read(path, MACHINE, NOW)
    path.write_text(path.read_text()[:-9])
    with pytest.raises(NotUsable, match="cannot be read"):
        warm_start_file.read(path, MACHINE, NOW)


# The daemon


class Told(NoDisplay):
    def __init__(self) -> None:
        self.events: list[Event] = []

    def event(self, event: Event) -> None:
        self.events.append(event)

    def of_warm_start(self) -> list[str]:
        return [event_sentence(event) for event in self.events if event.kind == "warm_start"]


pytestmark = pytest.mark.usefixtures("prepared")


@pytest.fixture
def talker() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel="tilth-warm") as bus:
        yield bus


def a_run(folder: Path, described: tuple[Machine, str] | None = None, **options: Any) -> tuple[Daemon, Told]:
    machine, text = described or rig(folder, VIRTUAL)
    result = Told()
    daemon = Daemon(MachineFile(machine, text), folder, None, result, **options)
    daemon.turn(0.0)
    return daemon, result


def now(frames: list[Frame]) -> list[Frame]:
    shift_ns = Clock().t_ns() - frames[0].t_ns
    return [replace(f, t_ns=f.t_ns + shift_ns, rx_ns=f.rx_ns + shift_ns) for f in frames]


def test_a_run_goes_on_from_the_one_before_and_its_log_replays_alone(
    tmp_path: Path, talker: can.BusABC
) -> None:
    first, result = a_run(tmp_path, keep=True)
    assert result.events == []
    teach(first.parts.estimation.fold.state, Clock().t_ns())
    first.close()
    second_rig = rig(tmp_path, VIRTUAL)
    second, result = a_run(tmp_path, second_rig, keep=True)
    (said,) = result.of_warm_start()
    assert said.startswith("steady_state, tracker, pem, rows, place continue from ")
    assert second.parts.estimation.fold.state.estimators["pem"].fits == 3
    for frame in now(list(simulate(MACHINE, 3, 4.0))):
        second.take(frame)
    logs = second.close().log_files  # two where the receivers tell the time early enough
    kinds = [type(record) for record in open_log(logs[0]).records]
    assert kinds[0] is Snapshot  # before any frame
    machine, text = second_rig
    summary = verified(logs, MachineFile(machine, text), 500)
    assert summary.estimates["pem"].parameters[0].value is not None
    assert summary.estimates["place"].of_place is not None  # the windows of the run before, in another plane


def test_a_run_that_begins_with_a_map_of_its_field_replays_alone(tmp_path: Path, talker: can.BusABC) -> None:
    state, file = taught(), tmp_path / "field.json"
    memory = state.estimators[place.METHOD]
    (window,) = memory.windows
    sure = replace(
        window.told, information=2500.0 * np.eye(6), vector=np.full(6, 250.0), model_sd=np.zeros(6)
    )
    memory.origin_deg = ORIGIN_DEG
    memory.windows = [
        replace(window, told=sure, path=window.path + np.array([9.0 * k, 0.0])) for k in range(6)
    ]
    learned = {place.METHOD: save_learned(state, NOW)[place.METHOD]}
    _, text = rig(tmp_path, VIRTUAL)
    text += f'\n[estimation]\nfield_map = "{file}"\n'
    machine = parse_machine(text)
    file.write_text(warm_start_file.text_of(machine, learned, Clock().t_ns() - 60 * SECOND))
    daemon, result = a_run(tmp_path, (machine, text), keep=True)
    assert "field map" in result.of_warm_start()[0]
    for frame in now(list(simulate(MACHINE, 3, 4.0))):
        daemon.take(frame)
    assert daemon.parts.estimation.fold.state.estimators["tracker"].map_mean is not None
    logs = daemon.close().log_files
    file.unlink()
    summary = verified(logs, MachineFile(machine, text), 500)
    assert "map_age_s" in summary.estimates["tracker"].excitation


def slipped() -> Moved:
    """The wheels' sensor, by a degree."""
    return Moved([WHEEL], np.array([0.0175]), 1e-6 * np.eye(1), NOW, InformationForm(), InformationForm())


def displaced() -> Moved:
    return Moved(
        ["tractor_rear"], np.array([0.1, 0.0]), 1e-4 * np.eye(2), NOW, InformationForm(), InformationForm()
    )


def on_the_disk(folder: Path) -> dict[str, Any]:
    (path,) = folder.glob("*.warm.json")
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def a_second_later(daemon: Daemon) -> bool:
    """Whether something was kept at once."""
    keeping, t_ns = daemon._keeping, Clock().t_ns() + SECOND
    assert keeping is not None
    due = keeping.is_due(t_ns)
    if due:
        keeping.keep(t_ns, daemon.parts.outlets.recording)
    return due


@pytest.mark.parametrize(
    ("what", "at_once", "methods"),
    [
        ("nothing", False, True),
        ("doubt", False, True),  # what was learned before it stays
        ("contradiction", True, False),  # nobody knows since when it has been wrong
        ("slipped", True, False),
        ("displaced", True, True),  # learned without that receiver
        ("accepted", True, False),  # it fits the value before
        ("doubt after accepted", True, False),
    ],
)
def test_what_the_next_run_has_to_know_is_kept_at_once(
    tmp_path: Path, talker: can.BusABC, what: str, at_once: bool, methods: bool
) -> None:
    first, _ = a_run(tmp_path, keep=True)
    teach(first.parts.estimation.fold.state, Clock().t_ns())
    first.close()
    daemon, _ = a_run(tmp_path, keep=True)
    state = daemon.parts.estimation.fold.state
    assert state.diagnosis.consistency.confirmed and not a_second_later(daemon)
    if what == "contradiction":
        finding = Diagnosis(Code.WHEEL_OPPOSITE, "wheel_angle.sign", state=DiagnosisState.ISOLATED)
        state.diagnosis.consistency.cases[finding.key] = FaultCase(finding, finding)
    elif what in ("slipped", "displaced"):
        state.diagnosis.watch.moved = [slipped() if what == "slipped" else displaced()]
    elif "accepted" in what:
        daemon.parts.estimation.fold.accept(Accepted(NOW, WHEEL, (0.0175,), (0.001,)))
    state.diagnosis.consistency.confirmed = what in ("nothing", "displaced")
    assert a_second_later(daemon) == at_once and not a_second_later(daemon)
    if what == "doubt after accepted":
        teach(state, Clock().t_ns())
        daemon._keeping.keep(Clock().t_ns(), daemon.parts.outlets.recording)  # type: ignore[union-attr]
        state.diagnosis.consistency.confirmed, methods = False, True
    daemon.close()
    kept = on_the_disk(tmp_path)
    assert bool(kept["methods"]) == methods
    assert len(kept["accepted"]) == ("accepted" in what)
    assert [moved["names"] for moved in kept["moved"]] == (
        [[WHEEL]] if what == "slipped" else [["tractor_rear"]] if what == "displaced" else []
    )


@pytest.mark.parametrize(
    ("found", "says"), [(slipped, "the wheel-angle sensor"), (displaced, "tractor_rear")]
)
def test_what_was_found_moved_stays_so_after_a_restart(
    tmp_path: Path, talker: can.BusABC, found: Callable[[], Moved], says: str
) -> None:
    """A driver who switches it off and on again has not put anything back."""
    first, _ = a_run(tmp_path, keep=True)
    state = first.parts.estimation.fold.state
    teach(state, Clock().t_ns())
    state.diagnosis.watch.moved = [found()]
    state.diagnosis.consistency.confirmed = found is displaced
    first.close()
    second_rig = rig(tmp_path, VIRTUAL)
    second, told = a_run(tmp_path, second_rig, keep=True)
    (event,) = [event_sentence(event) for event in told.events if event.kind == "moved"]
    assert says in event and "accept it as it is now" in event
    for frame in now(list(simulate(MACHINE, 3, 4.0))):
        second.take(frame)
    fold_now = second.parts.estimation.fold
    assert [names for names, _ in fold_now.moved] == [found().names]
    given = fold_now.estimates["recommended"].parameters
    if found is displaced:
        assert fold_now.state.aligner.tracks["tractor_rear"].left_out
        assert all(p.value is not None for p in given)
    else:
        assert all(p.value is None and p.status is Status.INVALID for p in given)
        assert "wheel_angle.zero" in sentence(given[0].reason)
    logs = second.close().log_files
    verified(logs, MachineFile(*second_rig), 500)


def test_what_is_left_out_stays_so_when_the_clock_of_the_log_steps_back() -> None:
    state = fold.initial(MACHINE)
    fold.carry(state, [displaced()])
    frames = list(simulate(MACHINE, 1, 2.0))
    back_ns = 60 * SECOND
    again = [replace(f, t_ns=f.t_ns - back_ns, rx_ns=f.rx_ns - back_ns) for f in frames]
    for frame in (*frames, *again):
        fold.step(state, frame)
    assert state.clock_steps == 1
    assert [mount for mount, track in state.aligner.tracks.items() if track.left_out] == ["tractor_rear"]


def test_a_fresh_run_and_one_of_another_rig_begin_anew(tmp_path: Path, talker: can.BusABC) -> None:
    first, _ = a_run(tmp_path, keep=True)
    teach(first.parts.estimation.fold.state, Clock().t_ns())
    first.close()
    fresh, result = a_run(tmp_path, keep=True, fresh=True)
    assert result.events == [] and fresh.parts.estimation.fold.state.estimators["pem"].fits == 0
    fresh.close()
    path = next(tmp_path.glob("*.warm.json"))  # still that of the first: the fresh run learned nothing
    plain = json.loads(path.read_text())
    path.write_text(json.dumps({**plain, "sections": {**plain["sections"], "implement": "another"}}))
    other, result = a_run(tmp_path, keep=True)
    assert ["[implement] of the machine file changed" in text for text in result.of_warm_start()] == [True]
    assert other.parts.estimation.fold.state.estimators["pem"].fits == 0
    other.close()


def test_without_keeping_there_is_no_file(tmp_path: Path, talker: can.BusABC) -> None:
    daemon, _ = a_run(tmp_path)
    teach(daemon.parts.estimation.fold.state, Clock().t_ns())
    daemon.close()
    assert list(tmp_path.glob("*.warm*")) == []
