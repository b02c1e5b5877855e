"""How much the implement carries, in the state of the fold: who says it, and what is done then.

An operator's word is logged before it is used, a scale's is in the log as frames. Where nobody says it, the
logarithm of the mass walks while the rig drives, and is open after each stop; C_ai is then known as badly as
the mass, C_ai over it as well as driving tells it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tilth.estimator.diagnosis.widening import OfLoad, widened
from tilth.estimator.filters.soil_field import SoilWindow
from tilth.estimator.methods import carrying, pem, place
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.methods.place import PlaceState
from tilth.estimator.models.load import LOAD, aged, another_variance, laden, of_nobody, of_scale, walked
from tilth.estimator.results.method_state import SixState
from tilth.estimator.state import ScaleWord, State
from tilth.schemas.flow import Carried, Estimate, EventKind, LoadSource, Pose, Weight
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.rejections import Rejection
from tilth.schemas.spread import plus_minus


def use(state: State, carried: Carried) -> None:
    """Go on with what somebody has said. The caller begins the open tracker and the aligner anew."""
    before, state.carried = state.machine, carried
    state.machine = laden(state.empty, carried)
    state.walked_ns = carried.t_ns
    for row in rows_for(state.machine):
        method_state = state.estimators[row.method]
        if isinstance(method_state, (SixState, PlaceState)):
            carrying.take_load(method_state, before, state.machine)
            row.rig_changed(method_state)  # a fit would take what is collected for driving with the new load
        else:
            state.estimators[row.method] = row.initial(state.machine)


def told(carried: Carried) -> Notice:
    words = plus_minus(carried.mass / 1e3, carried.sd / 1e3, "t")
    return notice(NoticeCode.LOAD_TOLD, carried=words, source=str(carried.source))


def weigh(state: State, t_ns: int, weight: Weight) -> Carried | None:
    """Take a scale's word. What is to be used, if anything is."""
    if state.carried is None:
        return None
    mass = of_scale(state.empty, weight.whole_mass, weight.carried_mass)
    if mass is None:
        rejected = state.decoder.rejected
        rejected[Rejection.OUT_OF_RANGE] = rejected.get(Rejection.OUT_OF_RANGE, 0) + 1
        return None
    before = state.scale
    if before is None or not 0 <= t_ns - before.t_ns < LOAD.scale_lost_ns:
        state.scale = ScaleWord(t_ns, mass)
    else:
        share = -math.expm1(-(t_ns - before.t_ns) * 1e-9 / LOAD.smoothed_s)
        state.scale = ScaleWord(t_ns, before.mass + share * (mass - before.mass))
    own, now = state.empty.implement.mass.value, state.carried
    change = abs(math.log((own + state.scale.mass) / (own + now.mass)))
    weighed = now.source is LoadSource.SCALE
    settled = (t_ns - state.walked_ns) * 1e-9 > LOAD.settled_s
    if weighed and change <= (LOAD.small_change if settled else LOAD.change):
        state.carried = replace(now, t_ns=t_ns)
        return None
    return Carried(t_ns, state.scale.mass, LOAD.weighed * (own + state.scale.mass), LoadSource.SCALE)


def walk(state: State, t_ns: int, pose: Pose) -> None:
    """Time has passed, and nobody has said the load."""
    if state.carried is None:
        return
    stood = _has_stood(state, state.carried, pose)
    if state.carried.source is LoadSource.SCALE and (
        state.scale is not None and t_ns - state.scale.t_ns < LOAD.scale_lost_ns
    ):
        return
    if stood:
        _after_stop(state, state.carried, t_ns)
    passed_ns = t_ns - state.walked_ns
    if 0 <= passed_ns < LOAD.step_ns:
        return
    if state.walked_ns and 0 <= passed_ns < LOAD.unknown_ns:
        _open_up(state, walked(state.empty, state.carried, passed_ns * 1e-9))
    state.walked_ns = t_ns


def _has_stood(state: State, carried: Carried, pose: Pose) -> bool:
    """Whether the rig drives again after a stop in which nobody has said what it carries since."""
    if not pose.direction:
        return False
    before, state.drove_ns = state.drove_ns, pose.t_ns
    return before > 0 and pose.t_ns - before >= LOAD.stop_ns and carried.t_ns <= before


def _after_stop(state: State, carried: Carried, t_ns: int) -> None:
    """The load may be any other: nothing is collected across a stop."""
    state.carried, state.stood_ns = _before_a_stop(state.empty, carried), t_ns
    for row in rows_for(state.machine):
        row.stood(state.estimators[row.method])
    _be_open(state)


def fitted_after_stop(state: State, method: str, closed_ns: int, windows: Sequence[SoilWindow]) -> bool:
    """A fit was adopted of driving that ended at closed_ns: if that was before the last stop, it knows
    nothing of it, and what it told is opened up. windows: of the memory by place, before the fit. Returns
    whether anything was."""
    learned = [state.estimators[name] for name in (method, place.METHOD)]
    learned = [one for one in learned if one.informed_ns == closed_ns <= state.stood_ns]
    for method_state in learned:
        carrying.open_up(method_state, state.machine, another_variance(state.empty), windows)
    return bool(learned)


def _be_open(state: State) -> None:
    """The load may be any other, and the first turn is to show it."""
    _open_up(state, another_variance(state.empty))
    fitted = state.estimators.get(pem.METHOD)
    if fitted is not None:
        fitted.soon = True


def _open_up(state: State, variance: float) -> None:
    for method_state in state.estimators.values():
        carrying.open_up(method_state, state.machine, variance)


def changed(state: State, t_ns: int) -> None:
    """Driving shows that it has changed, and not by how much: what was said of it is of before."""
    carried = of_nobody(state.empty, t_ns)
    assert carried is not None  # only an implement that carries something has such events
    use(state, carried)
    _be_open(state)


def in_doubt(state: State, events: list[tuple[str, Notice]]) -> list[tuple[str, Notice]]:
    """Events of a method that knows places, and not loads: what it takes for soil may be a load that nobody
    weighs."""
    if state.carried is None or state.carried.source is LoadSource.SCALE:
        return events
    either = EventKind.LOAD, notice(NoticeCode.LOAD_OR_SOIL)
    return [either if kind == EventKind.SOIL_CHANGE else (kind, told) for kind, told in events]


def known_now(state: State, t_ns: int, estimate: Estimate) -> Estimate:
    """An estimate whose C_ai is as uncertain as the mass is by now. Stiffnesses over the masses are so, too,
    but by a share: the mass acts on the forces between the bodies."""
    if state.carried is None:
        return estimate
    now = carried_now(state, t_ns) or state.carried
    whole = state.empty.implement.mass.value + state.carried.mass
    over_mass = (LOAD.couples * now.sd / whole) ** 2
    added = (now.sd**2 - state.carried.sd**2) / whole**2
    covariance = np.diag([over_mass, over_mass, over_mass + added, 0.0, 0.0, 0.0])
    return widened(OfLoad(covariance, over_mass), estimate)


def carried_now(state: State, t_ns: int) -> Carried | None:
    """As sure as it is at a time; None where the implement carries nothing."""
    told = state.carried
    return told and aged(state.empty, told, (t_ns - told.t_ns) * 1e-9)


def later(machine: Machine, told: Carried | None, elapsed_s: float, t_ns: int) -> Carried | None:
    """What a run before has left, so much later: what it has learned is over that mass, and as sure of it.
    Its age counts when an estimate is published. machine: as its file describes it."""
    if told is None or machine.implement.load is None:
        return None
    told = replace(told, t_ns=min(told.t_ns, t_ns - round(elapsed_s * 1e9)))
    return _before_a_stop(machine, told) if elapsed_s * 1e9 >= LOAD.stop_ns else told


def resumed(state: State, elapsed_s: float) -> None:
    """What a run before has learned is there, so much later: the rig has stood in between."""
    if state.carried is not None and state.previous_run and elapsed_s * 1e9 >= LOAD.stop_ns:
        _be_open(state)


def _before_a_stop(machine: Machine, told: Carried) -> Carried:
    """What was said before a stop tells as little as what is so old that all may have changed."""
    load = machine.implement.load
    assert load is not None
    return replace(told, t_ns=max(told.t_ns - round(load.lasts * 1e9), 0))
