"""What the implement carries: said by the operator or a scale, or by nobody; replayed, stored, resumed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cart import CART, FULL, LOAD_TEXT, known
from logs import MACHINE, MACHINE_TEXT
from posed import pose_of

from tilth.estimator import fold, implement_load
from tilth.estimator.filters import soil_change
from tilth.estimator.methods import pem, rows
from tilth.estimator.methods.estimators import ROW, Estimator, rows_for
from tilth.estimator.methods.pem import PemState
from tilth.estimator.methods.rows import RowsState
from tilth.estimator.methods.steady_state import SteadyState
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.models.load import another_variance, by_another_load, laden, moved_by
from tilth.estimator.record import straight_rows
from tilth.estimator.record.record import Record, Segment
from tilth.estimator.record.windows import WINDOWS
from tilth.estimator.results.method_state import SixState
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.state import ScaleWord, State
from tilth.estimator.state_json import to_json_data
from tilth.estimator.warm_start import SavedPosterior
from tilth.schemas.can_id import join
from tilth.schemas.carried import said_of_load
from tilth.schemas.flow import Carried, Event, EventKind, Frame, LoadSource, Weight
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.pgn_table import row

S = 1_000_000_000


def weight(t_ns: int, carried: float | None, whole: float | None = None) -> Frame:
    said = {"carried_mass_kg": carried, "whole_mass_kg": whole}
    data = row(65258).encode({key: value for key, value in said.items() if value is not None})
    return Frame(t_ns, t_ns, "can0", join(7, 65258, 0x40), True, False, data)


@pytest.mark.parametrize(
    ("text", "mass"),
    [
        ("full", 6000.0),
        ("empty", 0.0),
        ("half", 3000.0),
        ("6.2 t", 6200.0),
        ("5,5t", 5500.0),
        ("900 kg", 900.0),
    ],
)
def test_what_an_operator_says(text: str, mass: float) -> None:
    said = said_of_load(CART, text, 7)
    assert isinstance(said, Carried)
    assert said.mass == pytest.approx(mass) and said.sd > 0.0
    assert (said.t_ns, said.source) == (7, LoadSource.OPERATOR)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("8.2 t", "8.2 t is more than it carries when it is full (6.0 t), and than its tyres are meant for"),
        ("6200", "6200 is no load: say full, half, empty, unknown, or a mass with its unit"),
        ("-1 t", "-1 t is no load"), ("nan t", "nan t is no load"), ("1e9 kg", "1e9 kg is no load"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_load(text: str, words: str) -> None:
    said = said_of_load(CART, text, 1)
    assert isinstance(said, str) and words in said


def test_an_implement_that_carries_nothing() -> None:
    said = said_of_load(MACHINE, "full", 1)
    assert isinstance(said, str) and "add [implement.load] with mass" in said
    assert fold.initial(MACHINE).carried is None
    assert not by_another_load(MACHINE).any()


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("mass", "0", "give what it carries when it is full"),
        ("mass", "-3", "give what it carries when it is full"),
        ("exponent", "3", "tyres have 0.6 to 1"),
    ],
)
def test_files_that_cannot_be(key: str, value: str, words: str) -> None:
    lines = [line for line in LOAD_TEXT.splitlines() if not line.startswith(key)]
    with pytest.raises(MachineError, match=words):
        parse_machine(MACHINE_TEXT + "\n".join([*lines, f"{key} = {value}"]))


def test_nobody_knows_c_ai_but_c_ai_over_the_mass() -> None:
    state = fold.initial(CART)
    for name in ("tracker", "pem"):
        known(state, name)
        state.estimators[name].informed_ns = S
    state.diagnosis.consistency.confirmed = True
    made = implement_load.known_now(
        state, 2 * S, ROW["tracker"].estimate(state.estimators["tracker"], state.machine, 2 * S)
    )
    assert made.per_mass[2] is not None and made.per_mass_sd[2] is not None
    assert made.per_mass_sd[2] / made.per_mass[2] < 0.25
    assert made.parameters[2].value is None
    assert made.parameters[2].reason is not None and made.parameters[2].reason.code == "of_the_mass"


def test_a_scale_is_used_when_it_says_another_load() -> None:
    state = fold.initial(CART)
    first = fold.step(state, weight(S, 6000.0))
    assert [p.value.notice.code for p in first if isinstance(p.value, Event)] == ["load_told"]
    assert state.carried is not None and state.carried.source is LoadSource.SCALE
    assert any(isinstance(p.value, Weight) for p in first)
    quiet = fold.step(state, weight(2 * S, 5950.0))
    assert not [p for p in quiet if isinstance(p.value, Event)]
    masses = []
    for k in range(70):
        fold.step(state, weight((3 + k) * S, max(6000.0 - 400.0 * k, 0.0)))
        masses.append(state.machine.implement.mass.value)
    assert masses[-1] == pytest.approx(CART.implement.mass.value, rel=0.06) and masses == sorted(
        masses, reverse=True
    )
    fold.step(state, weight(73 * S, None, 1000.0))  # less than the empty implement
    assert state.rejected["out_of_range"] == 1


def test_stored_state_goes_on() -> None:
    state = fold.initial(CART)
    fold.carry_load(state, replace(FULL, t_ns=S))
    fold.step(state, weight(2 * S, 5000.0))
    again = restore(CART, snapshot(state))
    assert again.machine == state.machine and again.carried == state.carried and again.empty == state.empty
    assert snapshot(again) == snapshot(state)


def test_another_load_is_told_from_other_soil() -> None:
    known_before = np.diag([0.08, 0.08, 0.08, 0.2, 0.2, 0.2]) ** 2
    after, none = known_before / 4.0, np.zeros((6, 6))
    by_load = by_another_load(laden(CART, FULL))
    sure = soil_change.SOIL_CHANGE.sure
    for moved, side in (([0.0, 0.0, 0.4], 0), ([0.35, 0.4, 0.4], -1), ([-0.5, -0.5, -0.45], -1)):
        mean = np.array([*moved, 0.0, 0.0, 0.0]) * 0.75
        found = soil_change.odds((np.zeros(6), known_before), (mean, after), by_load, none)
        assert max(found) > soil_change.SOIL_CHANGE.loaded
        assert (found.of_load < -sure) == (side < 0)
        assert found.of_load < sure  # the implement may stand on other soil alone: then both stay open
    still = soil_change.odds((np.zeros(6), known_before), (np.full(6, 0.02), after), by_load, none)
    assert max(still) < 0.0


def test_a_run_that_comes_back_later_knows_less() -> None:
    now, sds = 10**9 * S, []
    for seconds in (10.0, 7 * 86_400.0):
        told = replace(FULL, t_ns=now - round(seconds * 1e9))
        state = fold.initial(CART, (), implement_load.later(CART, told, seconds, now))
        assert state.machine == laden(CART, FULL)  # over which it was learned
        carried = implement_load.carried_now(state, now)
        assert carried is not None and carried.mass == 6000.0
        sds.append(carried.sd)
    assert sds[0] < 900.0 and sds[1] > 6000.0
    gone_back = implement_load.later(CART, replace(FULL, t_ns=2 * now), 86_400.0, now)  # the clock
    assert gone_back is not None and gone_back.t_ns == now - 87_000 * S
    assert implement_load.later(MACHINE, FULL, 1.0, 1) is None


NOTHING = np.zeros((0, 0))


def turned(t_ns: int) -> Segment:
    """A segment of driving with turned wheels."""
    ticks = np.zeros((10, 8))
    ticks[:, 0], ticks[:, 1] = np.linspace(0.1, 0.3, 10), 4.0
    return Segment(Record(t_ns, ticks, np.zeros((0, 6))), True, None)


def driven(state: State, begin_s: int, seconds: int, u: float) -> list[float]:
    """At that speed for so long. Sds of the tracker's logarithms of C_af, C_ar and C_ai."""
    for t_s in range(begin_s, begin_s + seconds):
        pose = replace(pose_of(u, 0.0, 0.0), t_ns=t_s * S, direction=int(u > 0.0))
        implement_load.walk(state, t_s * S, pose)
    variances: list[float] = np.diag(state.estimators["tracker"].covariance)[:3].tolist()
    return [variance**0.5 for variance in variances]


@pytest.mark.parametrize(
    ("seconds", "word", "sd"),
    [
        (8, None, 0.083),  # at a gate
        (60, None, 0.215),
        (600, None, 0.23),  # once, beside the walk
        (60, LoadSource.OPERATOR, 0.085),
        (60, LoadSource.SCALE, 0.08),
    ],
)
def test_a_stop_may_have_changed_the_load(seconds: int, word: LoadSource | None, sd: float) -> None:
    state = fold.initial(CART)
    known(state, "tracker")
    before = driven(state, 1, 10, 4.0)
    if word is LoadSource.SCALE:
        state.scale = ScaleWord(11 * S, 3000.0)
    driven(state, 11, seconds, 0.0)
    if word is not None and state.carried is not None:
        state.carried = replace(state.carried, t_ns=(10 + seconds) * S, source=word)
    after = driven(state, 11 + seconds, 1, 4.0)
    assert after[:2] == before[:2] and after[2] == pytest.approx(sd, abs=0.01)
    assert state.estimators["pem"].soon == (sd > 0.2)  # the first turn is to show it
    assert restore(CART, snapshot(state)).drove_ns == (11 + seconds) * S


def collects(method_state: Any, pending: bool) -> None:
    """Puts in that a method has collected something. pending: and waits for a fit."""
    if isinstance(method_state, PemState):
        method_state.window = [turned(10 * S + k * S // 5) for k in range(WINDOWS.shortest)]
        method_state.job = pem.Job(S, S, turned(0).record, method_state.mean, NOTHING) if pending else None
    elif isinstance(method_state, RowsState):
        method_state.block.row = [turned(10 * S + k * S // 5) for k in range(straight_rows.SHORTEST)]
        made = [turned(0).record]
        method_state.job = rows.Job(S, S, made, False, method_state.mean, NOTHING) if pending else None
    elif isinstance(method_state, TrackerState):
        method_state.pending, method_state.running = turned(10 * S).record, True
    elif isinstance(method_state, SteadyState):
        method_state.steadiness.unaveraged = 3


@pytest.mark.parametrize("row", rows_for(CART), ids=lambda row: row.method)
def test_what_is_collected_is_of_the_load_before(row: Estimator) -> None:
    """A fit would be made with the load that somebody has said now."""
    state = fold.initial(CART)
    method_state = state.estimators[row.method]
    nothing = to_json_data(method_state)
    collects(method_state, pending=True)
    implement_load.use(state, replace(FULL, t_ns=20 * S))
    assert not fold.pending(state)
    for name in {"window", "job", "block", "pending", "running", "steadiness"} & nothing.keys():
        assert to_json_data(state.estimators[row.method])[name] == nothing[name], name


@pytest.mark.parametrize("pending", [False, True])
@pytest.mark.parametrize("seconds", [8, 60])
@pytest.mark.parametrize("row", rows_for(CART), ids=lambda row: row.method)
def test_nothing_is_collected_across_a_stop(row: Estimator, seconds: int, pending: bool) -> None:
    """Whether or not a fit is pending, which stays so. What was learned of all but the implement stays."""
    state = fold.initial(CART)
    driven(state, 1, 10, 4.0)
    method_state = state.estimators[row.method]
    collects(method_state, pending)
    before = to_json_data(method_state)
    driven(state, 11, seconds, 0.0)
    driven(state, 11 + seconds, 1, 4.0)
    stood = seconds > 20
    assert (state.stood_ns > 0) == stood
    assert to_json_data(method_state).get("job") == before.get("job")
    if isinstance(method_state, PemState):
        assert (not method_state.window and method_state.closed is not None) == stood
    elif isinstance(method_state, RowsState):
        assert (not method_state.block.row) == stood
        assert bool(method_state.block.complete) == method_state.block.ended == (stood and not pending)
    elif isinstance(method_state, TrackerState):
        assert (method_state.pending is None and not method_state.running) == stood
    elif isinstance(method_state, SteadyState):
        assert (method_state.steadiness.unaveraged == 0) == stood
    if isinstance(method_state, SixState):
        assert to_json_data(method_state)["mean"] == before["mean"]


@pytest.mark.parametrize("method", ["pem", "rows"])
def test_a_fit_of_before_a_stop_is_used_and_knows_nothing_of_the_load_after_it(method: str) -> None:
    """By what is known after a fit that is late, and after the same of driving since the stop."""
    known_after = []
    for closed_s in (5, 75):
        state = fold.initial(CART)
        driven(state, 1, 10, 4.0)
        driven(state, 11, 60, 0.0)
        driven(state, 71, 1, 4.0)
        learns, record = state.estimators[method], turned(0).record
        mean, prior = learns.mean + 0.1, learns.covariance.copy()
        found = pem.with_known_masses(prior) / 2.0 + pem.of_masses(prior)
        if method == "pem":
            learns.job = pem.Job(S, closed_s * S, record, learns.mean.copy(), prior)
            made: Any = pem.Fit(mean, found, None, 0.0, 1.0, -6.0, 3, 9, False, False, None)
        else:
            learns.job = rows.Job(S, closed_s * S, [record], True, learns.mean.copy(), prior)
            made = rows.Fit(mean, found, 0.9, 0.01, 60.0, 5, -6.0, False, False, None)
        fold.adopt(state, 80 * S, method, made)
        assert learns.fits == 1 and np.array_equal(learns.mean, mean)
        known_after.append(learns.covariance.copy())
    late, timely = known_after
    opened = np.zeros_like(late)
    opened[:6, :6] = moved_by(CART, another_variance(CART))
    np.testing.assert_allclose(late - timely, opened, atol=1e-9)


@pytest.mark.parametrize(
    ("there", "elapsed_s", "opens"), [(True, 60, True), (True, 5, False), (False, 60, False)]
)
def test_a_run_before_was_ended_by_a_stop(there: bool, elapsed_s: int, opens: bool) -> None:
    state = fold.initial(CART)
    known(state, "tracker")
    before = state.estimators["tracker"].covariance.copy()
    state.previous_run = (
        {"tracker": SavedPosterior(("C_ai",), np.zeros(1), np.eye(1), 0.0, {})} if there else {}
    )
    implement_load.resumed(state, elapsed_s)
    wider = np.diag(state.estimators["tracker"].covariance) > np.diag(before)
    assert wider[2] == opens and not wider[:2].any() and state.estimators["pem"].soon == opens


def test_an_event_of_the_load_is_one() -> None:
    out = fold.carry_load(fold.initial(CART), replace(FULL, t_ns=S))
    (event,) = (p.value for p in out if isinstance(p.value, Event))
    assert event.kind == EventKind.LOAD and str(event.notice.values["carried"]).startswith("6.00 ±")
