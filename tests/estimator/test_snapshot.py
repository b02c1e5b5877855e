"""The stored state of the fold: all of it comes back, and what is not whole is refused with a reason."""

import json
from collections.abc import Callable
from dataclasses import fields
from enum import Enum
from functools import cache
from typing import Any

import numpy as np
import pytest
from circle import demo_machine

from tilth.estimator.diagnosis import consistency
from tilth.estimator.fold import State, initial, step
from tilth.estimator.methods import open_tracker
from tilth.estimator.methods.estimators import ESTIMATORS, Estimator
from tilth.estimator.methods.open_tracker import OpenTracker
from tilth.estimator.rig.lifecycle import FaultCase, Persistence
from tilth.estimator.snapshot import VERSION, NotRestorable, restore, restore_decoder, snapshot
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code, Reason
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

ASKING = ("[zenoh]\n", "[estimation]\ntwo_step = true\n\n[zenoh]\n")  # so that all methods run
MACHINE = demo_machine(**dict([ASKING]))


@cache
def stored() -> str:
    """After five seconds; not to be changed."""
    state = initial(MACHINE)
    for frame in simulate(MACHINE, 3, 5.0, Scenario(other_traffic=False)):
        step(state, frame)
    return snapshot(state)


def other(value: Any, number: int) -> Any:
    """Another value of the same type and shape."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + number
    if isinstance(value, str):
        return f"{value} and {number}"
    if isinstance(value, np.ndarray):
        return value + number
    if isinstance(value, Enum):
        return next(one for one in type(value) if one is not value)
    if isinstance(value, dict):
        return {Code.NO_RTK: number}
    if isinstance(value, list):
        return [other(one, number) for one in value]
    return value


def changed(state: Any) -> Any:
    """Each attribute has a value that no other has, so that one that is left out or exchanged shows."""
    for number, field in enumerate(fields(state), start=1):
        setattr(state, field.name, other(getattr(state, field.name), number))
    return state


@pytest.mark.parametrize("row", ESTIMATORS, ids=lambda row: row.method)
def test_each_attribute_of_a_method_comes_back_in_its_place(row: Estimator) -> None:
    state = changed(row.initial(MACHINE))
    text = json.dumps(to_json_data(state))
    again = from_json_data(row.state, json.loads(text))
    assert type(again) is type(state) and to_json_data(again) == to_json_data(state)
    assert json.dumps(to_json_data(again)) == text
    assert len(json.loads(text)) == sum(f.metadata.get("stored", True) for f in fields(state))


def test_each_attribute_of_consistency_comes_back_in_its_place() -> None:
    state = consistency.Consistency()
    state.confirmed, state.open_restarted, state.missing = True, True, Reason(Code.DOUBTED, ("tractor.a",))
    one = Diagnosis(
        Code.DRIVING_FINDS, "tractor.a", ("a",), ("a",), (0.1,), (0.2,), 7, DiagnosisState.ISOLATED
    )
    state.methods = {"pem": [one]}
    state.cases = {"a": FaultCase(one, one, Persistence(1, 2), 3)}
    tracker = changed(open_tracker.initial(MACHINE).tracker)
    open_state = OpenTracker(tracker, 7, [(1.0, 2.0)])
    again = from_json_data(OpenTracker, json.loads(json.dumps(to_json_data(open_state))))
    assert to_json_data(again) == to_json_data(open_state)
    again = from_json_data(consistency.Consistency, json.loads(json.dumps(to_json_data(state))))
    assert to_json_data(again) == to_json_data(state)


def test_it_is_json_of_a_version_and_not_long() -> None:
    document = json.loads(stored())
    assert document["version"] == VERSION
    assert set(document["estimators"]) == {row.method for row in ESTIMATORS}
    # All that the fold remembers, but for the machine file and what each step gives anew.
    kept = {f.name for f in fields(State)} - {"machine", "empty", "file", "estimates", "segments"}
    assert set(document) == {"version"} | kept
    del document["estimators"]["pem_two_step"]  # which few ask for
    assert (
        len(json.dumps(document, separators=(",", ":"))) < 500_000
    )  # 66 unknowns, the covariance of which three methods keep, one twice
    assert snapshot(restore(MACHINE, stored())) == stored()


def spoilt(change: Callable[[dict[str, Any]], object]) -> str:
    document = json.loads(stored())
    change(document)
    return json.dumps(document)


Change = Callable[[dict[str, Any]], object]
REFUSED: tuple[tuple[str, Change, str], ...] = (
    ("no version", lambda p: p.pop("version"), "it is of another version: 1 or none"),
    ("older", lambda p: p.update(version=VERSION - 1), f"it is of another version: {VERSION - 1}, where"),
    ("newer", lambda p: p.update(version=VERSION + 1), f"it is of another version: {VERSION + 1}, where"),
    ("no number", lambda p: p.update(version=[]), "it is of another version"),
    ("a part less", lambda p: p.pop("time"), "it is damaged: State: time is missing"),
    (
        "a part more",
        lambda p: p.update(mood=1),
        "it is damaged: State: mood is not known",
    ),
    ("another kind", lambda p: p.update(frames="x"), "frames: 'x' is no int"),
    ("no decoder", lambda p: p.pop("decoder"), "it is damaged: 'decoder'"),
    ("a machine of its own", lambda p: p.update(machine=1), "State: machine is not known"),
    ("another below", lambda p: p["aligner"].update(machine=1), "aligner: machine is not known"),
    ("a decoder's part less", lambda p: p["decoder"].pop("addresses"), "it is damaged: 'addresses'"),
    ("no table", lambda p: p.update(estimators="none"), "estimators: 'none' is no dict"),
    (
        "an array less",
        lambda p: p["estimators"]["pem"].pop("mean"),
        "PemState: mean is missing",
    ),
    (
        "another shape",
        lambda p: p["estimators"]["pem"].update(mean=[0.0]),
        "PemState: mean: an array of (1,), not of",
    ),
    (
        "half an array",
        lambda p: p["estimators"]["tracker"]["mean"].update(base64="AAAA"),
        "TrackerState: mean: ",
    ),
    ("no list", lambda p: p["estimators"]["tracker"].update(considered=3), "considered: '3' is no list"),
    (
        "a nested part less",
        lambda p: p["aligner"]["latency"].pop("tau"),
        "State: aligner: latency: tau is missing",
    ),
    ("a nested part more", lambda p: p["record"].update(mood=1), "State: record: mood is not known"),
    (
        "other receivers",
        lambda p: p["aligner"]["tracks"].popitem(),
        "it is of a machine with other receivers",
    ),
)


@pytest.mark.parametrize(("change", "names"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_what_is_not_whole_is_refused_with_a_reason(change: Change, names: str) -> None:
    with pytest.raises(NotRestorable) as error:
        restore(MACHINE, spoilt(change))
    assert names in str(error.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "null", "cut", "[" * 100_000], ids=lambda text: text[:4]
)
def test_what_is_no_stored_state_is_refused_too(text: str) -> None:
    text = stored()[:1000] if text == "cut" else text
    for take in (restore, restore_decoder):
        with pytest.raises(NotRestorable, match="it is damaged: "):
            take(MACHINE, text)


def test_a_state_from_before_a_method_was_enabled_is_restored() -> None:
    usual: Machine = demo_machine()
    again = restore(MACHINE, snapshot(initial(usual)))
    assert set(again.estimators) == {row.method for row in ESTIMATORS}


def test_the_decoder_alone() -> None:
    assert restore_decoder(MACHINE, stored()).dump() == json.loads(stored())["decoder"]
    older = spoilt(lambda p: p.update(version=1))  # of which this part is still known
    assert restore_decoder(MACHINE, older).dump() == json.loads(stored())["decoder"]
    with pytest.raises(NotRestorable, match="another version"):
        restore_decoder(MACHINE, '{"version": 1, "decoder": {}}')
    with pytest.raises(NotRestorable, match="it is damaged"):
        restore_decoder(MACHINE, spoilt(lambda p: p["decoder"].pop("assembler")))
