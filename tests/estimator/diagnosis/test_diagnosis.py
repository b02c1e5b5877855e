"""The diagnosis tells the fold what to do, and the fold does it to every stage."""

import numpy as np
import pytest
from circle import demo_machine

from tilth.estimator import fold
from tilth.estimator.diagnosis import diagnosis
from tilth.estimator.diagnosis.diagnosis import RigDiagnosis
from tilth.estimator.diagnosis.directive import Directive
from tilth.estimator.diagnosis.information import InformationForm
from tilth.estimator.diagnosis.watch import Moved
from tilth.estimator.methods import open_tracker
from tilth.estimator.rig.numbers import WHEEL
from tilth.estimator.state_json import to_json_data
from tilth.schemas.flow import Accepted, Event, FlagKind, Frame, Publication
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import event_sentence
from tilth.simulator.traffic import simulate

MACHINE = demo_machine()


def driven(seconds: float = 6.0) -> tuple[fold.State, list[Frame]]:
    state, frames = fold.initial(MACHINE), list(simulate(MACHINE, 3, seconds))
    for frame in frames:
        fold.step(state, frame)
    return state, frames


def found(names: list[str], amounts: tuple[float, ...]) -> Moved:
    before, after = InformationForm(since_ns=1), InformationForm(since_ns=5)
    return Moved(names, np.array(amounts), 1e-4 * np.eye(len(amounts)), 5, before, after)


@pytest.mark.parametrize(
    ("names", "amounts", "excluded"),
    [
        (["tractor_rear"], (0.1, 0.0), {"tractor_rear"}),
        (["tractor_rear", "pair_tractor"], (0.1, 0.0), set()),  # it is not known which
        ([WHEEL], (0.02,), set()),
    ],
)
def test_what_was_moved_before_is_left_out_and_else_it_contradicts(
    names: list[str], amounts: tuple[float, ...], excluded: set[str]
) -> None:
    state = fold.initial(MACHINE)
    fold.carry(state, [found(names, amounts)])
    assert {mount for mount, track in state.aligner.tracks.items() if track.left_out} == excluded
    for frame in simulate(MACHINE, 3, 6.0):
        fold.step(state, frame)
    keys = [one.key for one in diagnosis.contradictions(state.diagnosis)]
    assert bool(keys) == (not excluded)
    flags = [flag for flag in state.flags if flag.kind is FlagKind.CONTRADICTION]
    assert [flag.of for flag in flags] == keys
    assert all(p.value is None for p in state.estimates["recommended"].parameters)


def test_a_reset_puts_every_method_and_the_open_tracker_to_the_beginning() -> None:
    state, frames = driven()
    first = fold.initial(MACHINE)
    assert to_json_data(state.open) != to_json_data(first.open)
    fold._apply(state, Directive(reset=True, reset_open=True), frames[-1].t_ns, [])
    assert to_json_data(state.open) == to_json_data(open_tracker.initial(MACHINE))
    assert to_json_data(state.estimators) == to_json_data(first.estimators)


def test_what_a_directive_does_not_say_stays() -> None:
    state, frames = driven()
    before = to_json_data(state)
    out = list[Publication]()
    fold._apply(state, Directive(), frames[-1].t_ns, out)
    assert to_json_data(state) == before and out == []
    fold._apply(state, Directive(exclude=frozenset({"tractor_rear"}), lagging=frozenset()), 0, out)
    assert state.aligner.tracks["tractor_rear"].left_out and out == []


def test_other_soil_begins_the_open_tracker_anew_only_in_a_confirmed_file() -> None:
    state = RigDiagnosis()
    assert diagnosis.soil_changed(state) == Directive()
    diagnosis.resumed(state, True)
    assert diagnosis.soil_changed(state) == Directive(reset_open=True) and state.confirmed


def test_a_value_that_is_accepted_has_to_be_confirmed_anew() -> None:
    state, frames = driven()
    diagnosis.resumed(state.diagnosis, True)
    state.diagnosis.watch.moved = [found(["tractor_rear"], (0.1, 0.0))]
    (event,) = fold.accept(state, Accepted(frames[-1].t_ns, "tractor_rear", (0.1, 0.0), (0.01, 0.01)))
    assert isinstance(event.value, Event) and "tractor_rear" in event_sentence(event.value)
    assert not state.diagnosis.confirmed and not any(t.left_out for t in state.aligner.tracks.values())


def test_without_the_wheel_angle_no_method_gives_a_number() -> None:
    state, _ = driven(3.0)
    state.diagnosis.consistency.sensor_fault = Code.WHEEL_ANGLE_STANDS
    told = fold.estimates_now(state)["tracker"]
    assert all(p.reason is not None and p.reason.code is Code.WHEEL_ANGLE_STANDS for p in told.parameters)
