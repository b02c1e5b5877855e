"""Has something been moved since this drive began: a receiver, a pair, the wheels' sensor?

Samples go into blocks of 20 s. With each whole block, what the last 40 s to ten minutes tell of the rig's
constants is compared with what all driving before that told, for each suspect and each such length of time:
a window-limited generalized likelihood ratio test. A suspect whose ratio is above `threshold`, by an amount
that matters, has been moved. From then on it is compared with how it is now, so that being put back is found
too.

What is wrong from the start is no change. Each five seconds all samples are held against the machine file in
the same way (against_file.py).
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis import against_file, wheel_speed
from tilth.estimator.diagnosis.hypotheses import Explanation, hypotheses, judge, posterior
from tilth.estimator.diagnosis.information import (
    KINDS,
    InformationForm,
    N,
    drift,
    lengths,
    prior_information,
    rows,
)
from tilth.estimator.diagnosis.sample import sample
from tilth.estimator.diagnosis.wheel_speed import WheelSpeedState
from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.rig.numbers import HYPOTHESIS, WHEEL_SPEED
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.flow import WITHOUT_RTK, Accepted, Mount, Pose
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WatchTuning:
    """When something has been moved."""

    block: int = tuned(100, "samples", "20 s")
    since: tuple[int, ...] = tuned(
        (2, 3, 4, 6, 9, 12, 18, 24, 30), "blocks", "ago, when something may have been moved"
    )
    least_before: int = tuned(6, "blocks", "before that, to compare with")
    memory: float = tuned(180.0, "blocks", "an hour of driving over which older samples count ever less")
    false_alarm: float = tuned(1000.0, "h", "of driving with one false alarm of each suspect")
    rival: float = tuned(0.01, "1", "of the best likelihood: what explains so much may be it as well")
    nearly: float = tuned(0.6, "1", "of the log likelihood ratio of a latency: so much, it may be a receiver")
    look: int = tuned(25, "samples", "5 s between two looks at the machine file itself")
    scatter_memory: float = tuned(0.1, "1", "share of a new block in the scatter of the rows")


WATCH: Final = WatchTuning()


def threshold() -> float:
    """Of the logarithm of a likelihood ratio, for one false alarm of a suspect in T of driving.

    At one look and one span of time a ratio is above x with a chance of exp(-x) at most. With a look each t
    and n spans these chances add up to n T / t exp(-x) in T: so x = ln(n T / t).
    """
    looks = WATCH.false_alarm * 3600e9 / (WATCH.block * ALIGNMENT.pose_ns)
    return math.log(len(WATCH.since) * looks)


@dataclass(slots=True)
class Moved:
    """Something that has been moved and not been accepted."""

    names: list[str]  # the best explanation first; more than one until the samples tell them apart
    amounts: Array  # (m,) of names[0]: forward and right, m; or one angle, rad; or m
    covariance: Array  # (m, m)
    since_ns: int  # it happened about then
    before: InformationForm  # all samples before that
    after: InformationForm  # those since then
    followed: bool = True  # `after` grows, since nothing else has been moved meanwhile
    now: InformationForm | None = (
        None  # of an earlier run's: the samples of this one, by which it may be back
    )

    @property
    def diagnosis(self) -> Diagnosis:
        """What has been moved, by how much; suspected while it may be something else as well."""
        row, sds = HYPOTHESIS[self.names[0]], np.sqrt(np.diag(self.covariance))
        return Diagnosis(
            row.code, row.key, tuple(self.names), row.numbers, tuple(self.amounts.tolist()),
            tuple(sds.tolist()), self.since_ns,
            DiagnosisState.SUSPECTED if self.names[1:] else DiagnosisState.ISOLATED,
        )  # fmt: skip


@dataclass(slots=True)
class WatchState:
    """Plain data."""

    old: InformationForm = field(default_factory=InformationForm)  # all before `blocks`
    old_blocks: float = 0.0  # how many blocks are in it; older ones count less
    blocks: list[InformationForm] = field(default_factory=list)  # the last whole ones
    block: InformationForm = field(default_factory=InformationForm)  # of now
    samples: int = 0  # in it
    mean: Array = field(default_factory=lambda: np.zeros(N))  # of the constants, at the last block
    scatter: Array = field(
        default_factory=lambda: np.ones(KINDS)
    )  # variance of a pose's rows over the expected
    sums: Array = field(default_factory=lambda: np.zeros((KINDS, 3)))  # of the block: n, sum, sum of squares
    moved: list[Moved] = field(default_factory=list)
    wrong: list[Diagnosis] = field(default_factory=list)  # lengths of the machine file, from the start
    wheel_speed: WheelSpeedState = field(default_factory=WheelSpeedState)  # of the tyres' radius


def observe(state: WatchState, aligner: Aligner, pose: Pose) -> list[Diagnosis]:
    """Take one pose. Returns what was found moved with it."""
    speed = pose.tractor.forward_velocity
    if speed is None or speed < DRIVING.under_way or any(flag.kind in WITHOUT_RTK for flag in pose.flags):
        return []
    now = sample(aligner, pose.t_ns - ALIGNMENT.pose_ns)
    if now is None:
        return []
    _add(state, aligner.machine, rows(lengths(aligner.machine), now), pose.t_ns)
    if state.samples % WATCH.look == 0:
        state.wrong = _wrong(state, aligner.machine)
    if state.samples < WATCH.block:
        return []
    _end_block(state, aligner.machine)
    return _look(state, aligner.machine)


def _add(
    state: WatchState, machine: Machine, given: tuple[NDArray[np.int64], Array, Array], t_ns: int
) -> None:
    kinds, design, measured = given
    rig, block = lengths(machine), state.block
    block.since_ns = block.since_ns or t_ns
    off = measured - design @ state.mean
    state.sums[kinds, 0] += 1.0
    state.sums[kinds, 1] += off
    state.sums[kinds, 2] += off**2
    variance = rig.sds[kinds] ** 2 * rig.correlated[kinds] * state.scatter[kinds]
    weighted = design.T / variance
    block.information += weighted @ design
    block.vector += weighted @ measured
    state.samples += 1


def _wrong(state: WatchState, machine: Machine) -> list[Diagnosis]:
    """What is not as in the machine file. What has been moved is said of its own."""
    if state.moved:
        return []
    return against_file.found(machine, _sum([state.old, *state.blocks, state.block]), bool(state.wrong))


def _end_block(state: WatchState, machine: Machine) -> None:
    n, total, squares = state.sums.T
    enough = n > WATCH.block / 4
    variance = (squares - total**2 / np.maximum(n, 1.0)) / np.maximum(n, 1.0)
    seen = np.maximum(variance / lengths(machine).sds ** 2, 1.0)
    state.scatter[enough] += WATCH.scatter_memory * (seen - state.scatter)[enough]
    state.blocks.append(state.block)
    state.block, state.samples, state.sums = InformationForm(), 0, np.zeros((KINDS, 3))
    if len(state.blocks) > WATCH.since[-1]:
        _age(state, state.blocks.pop(0))


def _age(state: WatchState, block: InformationForm) -> None:
    keep = 1.0 - 1.0 / WATCH.memory
    state.old = _sum(
        [InformationForm(keep * state.old.information, keep * state.old.vector, state.old.since_ns), block]
    )
    state.old_blocks = keep * state.old_blocks + 1.0


def _sum(parts: list[InformationForm]) -> InformationForm:
    since_ns = next((part.since_ns for part in parts if part.since_ns), 0)
    return InformationForm(
        sum((part.information for part in parts), np.zeros((N, N))),
        sum((part.vector for part in parts), np.zeros(N)),
        since_ns,
    )


def _look(state: WatchState, machine: Machine) -> list[Diagnosis]:
    state.mean, _ = posterior(_sum([state.old, *state.blocks]))
    told = _follow(state, machine)
    best: tuple[int, list[Explanation]] | None = None
    for since in WATCH.since:
        if state.old_blocks + len(state.blocks) - since < WATCH.least_before:
            break
        before, now = _sum([state.old, *state.blocks[:-since]]), _sum(state.blocks[-since:])
        explanations = judge(machine, *posterior(before), now)
        if best is None or explanations[0].log_ratio > best[1][0].log_ratio:
            best = (since, explanations)
    if best is None or exceeds(threshold(), best[1][0].log_ratio) or not _matters(best[1][0]):
        return told
    return told + _found(state, machine, *best)


def _follow(state: WatchState, machine: Machine) -> list[Diagnosis]:
    """How far what has been moved is moved by all samples since; returns what is known by name now."""
    told = []
    for moved in list(state.moved):
        if moved.now is not None:
            moved.now = _sum([moved.now, state.blocks[-1]])
            if _is_back(machine, moved, moved.now):
                state.moved.remove(moved)
                told.append(replace(moved.diagnosis, state=DiagnosisState.CLEARED))
            continue
        if moved.followed:
            moved.after = _sum([moved.after, state.blocks[-1]])
        explanations = judge(machine, *posterior(moved.before), moved.after)
        names, before = _names(explanations), moved.names
        if len(moved.names) > 1 and names:
            moved.names = names
        _set(moved, next(explanation for explanation in explanations if explanation.name == moved.names[0]))
        if len(moved.names) == 1 < len(before):
            told.append(moved.diagnosis)
    return told


def _is_back(machine: Machine, moved: Moved, now: InformationForm) -> bool:
    """Whether the samples of this run contradict what an earlier one had found, and find it in its place."""
    explanations = judge(machine, *posterior(moved.before), now)
    here = next(explanation for explanation in explanations if explanation.name == moved.names[0])
    apart = here.amounts - moved.amounts
    log_ratio = apart @ np.linalg.solve(here.covariance + moved.covariance, apart) / 2.0
    return exceeds(float(log_ratio), threshold()) and not _matters(here)


def carried(machine: Machine, moved: Moved) -> Moved:
    """What an earlier run has found, in a new one: nobody has accepted it, and it may have been put back.

    Raises ValueError for what is of another version.
    """
    sizes = {hypothesis.name: hypothesis.directions.shape[1] for hypothesis in hypotheses(machine)}
    size = sizes.get(moved.names[0]) if moved.names else None
    arrays = (moved.before.information, moved.after.information, moved.covariance)
    if [array.shape for array in arrays] != [(N, N), (N, N), (size, size)]:
        raise ValueError(f"what was found of {' or '.join(moved.names)} is of another version")
    return replace(moved, followed=False, now=InformationForm())


def _set(moved: Moved, explanation: Explanation) -> None:
    moved.amounts, moved.covariance = explanation.amounts, explanation.covariance


def _names(explanations: list[Explanation]) -> list[str]:
    """What explains it about as well as the best does."""
    least = explanations[0].log_ratio + math.log(WATCH.rival)
    return [v.name for v in explanations if exceeds(v.log_ratio, least) and not HYPOTHESIS[v.name].absorbed]


def _like_another(explanations: list[Explanation]) -> bool:
    """Whether something that is no latency explains it nearly as well as the latency that does best."""
    others = [v.log_ratio for v in explanations if not HYPOTHESIS[v.name].absorbed]
    return exceeds(max(others), WATCH.nearly * explanations[0].log_ratio)


def _found(
    state: WatchState, machine: Machine, since: int, explanations: list[Explanation]
) -> list[Diagnosis]:
    """Something has been moved."""
    first, names = explanations[0], _names(explanations)
    if HYPOTHESIS[first.name].absorbed and _like_another(explanations):
        return []  # a receiver that is further forward looks alike until it is driven at another speed
    before, after = _sum([state.old, *state.blocks[:-since]]), _sum(state.blocks[-since:])
    _absorb(state, machine, since, before, first)
    for moved in state.moved:
        moved.followed = False
    if HYPOTHESIS[first.name].absorbed:  # the poses learn it too
        return []
    known = next((moved for moved in state.moved if first.name in moved.names), None)
    if known is None:
        found = Moved(names, first.amounts, first.covariance, after.since_ns, before, after)
        state.moved.append(found)
        return [found.diagnosis]
    known.after, known.followed, known.now = after, True, None
    again = judge(machine, *posterior(known.before), after)
    _set(known, next(explanation for explanation in again if explanation.name == known.names[0]))
    if _matters(Explanation(known.names[0], 0.0, known.amounts, known.covariance)):
        return [known.diagnosis]
    state.moved.remove(known)
    return [replace(known.diagnosis, state=DiagnosisState.CLEARED)]


def _matters(explanation: Explanation) -> bool:
    return exceeds(float(np.linalg.norm(explanation.amounts)), HYPOTHESIS[explanation.name].least)


def _absorb(
    state: WatchState, machine: Machine, since: int, before: InformationForm, found: Explanation
) -> None:
    """What was learned before now predicts the samples since: moved by what was found."""
    directions = directions_of(machine, found.name)
    mean, covariance = posterior(before)
    covariance = covariance + drift() + directions @ found.covariance @ directions.T
    information = np.linalg.inv(covariance) - prior_information()
    vector = np.linalg.solve(covariance, mean + directions @ found.amounts)
    state.old, state.old_blocks = (
        InformationForm(information, vector, before.since_ns),
        float(WATCH.least_before),
    )
    state.blocks = state.blocks[-since:]


def found_now(state: WatchState) -> list[Diagnosis]:
    """All that is not as in the file, by the names in `of` it may be accepted."""
    found = [moved.diagnosis for moved in state.moved]
    return found if state.wheel_speed.change is None else [*found, state.wheel_speed.change.diagnosis]


def left_out(state: WatchState) -> frozenset[str]:
    """Mounts of the receivers that have been moved and are known by name: the others still give poses."""
    return frozenset(m.names[0] for m in state.moved if len(m.names) == 1 and m.names[0] in set(Mount))


def contradictions(state: WatchState) -> list[Diagnosis]:
    """What has been moved and cannot be done without, or was wrong in the file from the start."""
    out = left_out(state)
    return [*(moved.diagnosis for moved in state.moved if moved.names[0] not in out), *state.wrong]


def proposal(state: WatchState, machine: Machine, what: str, t_ns: int) -> Accepted | None:
    """The value that may be accepted by that name; None where there is none."""
    if what == WHEEL_SPEED:
        return wheel_speed.proposal(state.wheel_speed, t_ns)
    moved = next((moved for moved in state.moved if what in moved.names), None)
    if moved is None:
        return None
    explanations = judge(machine, *posterior(moved.before), moved.after)
    found = next(explanation for explanation in explanations if explanation.name == what)
    sds = np.sqrt(np.diag(found.covariance))
    return Accepted(t_ns, what, tuple(found.amounts.tolist()), tuple(sds.tolist()))


def accept(state: WatchState, machine: Machine, accepted: Accepted) -> None:
    """The machine file has these values from now on; machine: without them.

    All that was learned is measured against them from here on.
    """
    if accepted.what == WHEEL_SPEED:
        wheel_speed.accept(state.wheel_speed)
        return
    shift = directions_of(machine, accepted.what) @ np.array(accepted.amounts)
    held = [evidence for moved in state.moved for evidence in (moved.before, moved.after, moved.now)]
    for evidence in (state.old, *state.blocks, state.block, *filter(None, held)):
        evidence.vector = evidence.vector - evidence.information @ shift
    state.mean = state.mean - shift
    state.moved = [moved for moved in state.moved if accepted.what not in moved.names]
    state.wrong = []


def directions_of(machine: Machine, name: str) -> Any:
    """(N, m): change of the constants by each amount of a suspect."""
    return next(hypothesis.directions for hypothesis in hypotheses(machine) if hypothesis.name == name)
