"""The estimators, one row each: an extension point. Tests run over every row.

The functions of a row share a state of their own type, a dataclass. It is stored in the log and restored from
it, all of it, by what its annotations say (state_json.py): whoever changes a field raises `VERSION` of
snapshot.py. Its `events` have not been published yet. A row with `fitting` requests fits, which are computed
outside the fold.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tilth.estimator.compiled import Kernel
from tilth.estimator.diagnosis.open_numbers import Misfit
from tilth.estimator.filters import propagation, row_filter, steady_outputs, unknowns
from tilth.estimator.methods import learned, pem, place, rows, steady_state, tracker, two_step
from tilth.estimator.methods.learned import Learned
from tilth.estimator.record.record import Segment
from tilth.schemas.flow import PARAMETERS, Estimate, Pose
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class Fitting:
    """How a row's fits are requested, computed and adopted. The pending job is `state.job`."""

    latency_ns: int  # of the log's time, from the request to the adoption
    request_fit: Callable[[Any, int], Any]  # (state, t_ns): a job, or None
    fit: Callable[[Machine, Any], Any]  # a pure function of machine and job
    rehearse: Callable[[Machine], None]  # a fit of made-up data, which compiles what a fit needs
    adopt: Callable[[Any, Machine, Any, int], Estimate]  # (state, machine, result or None, t_ns)
    finish: Callable[[Any], None]  # (state): no driving follows, so that the present window is complete
    rehearse_alone: Callable[[], None] = lambda: None  # compiles what no other process begins with
    of_file: Callable[[Any], tuple[Misfit, float] | None] = lambda made: None
    """(result): what it tells of the machine file, and s of driving that this is of; None: nothing."""


@dataclass(frozen=True, slots=True)
class Memory:
    """What of a row's state is carried over to the next run, besides `informed_ns`."""

    names: tuple[str, ...]  # of the entries of the mean
    per_run: tuple[str, ...]  # names that start from the prior in each run
    learned: Callable[[Any], Learned]  # (state): what it has learned
    resume: Callable[[Any, Learned], None]  # (fresh state, what was learned): changes the state


@dataclass(frozen=True, slots=True)
class Estimator:
    method: str  # published on /soil_tire/<method>
    state: type[Any]  # of what `initial` makes
    initial: Callable[[Machine], Any]
    take: Callable[
        [Any, Machine, Pose, Segment | None], Estimate | None
    ]  # changes the state; an estimate when one is due
    estimate: Callable[[Any, Machine, int], Estimate]  # the estimate at a time, ns
    clock_stepped: Callable[
        [Any, int], None
    ]  # the log's clock ran on by so many ns, below zero; keep what was learned
    stood: Callable[[Any], None] = lambda state: None
    """(state): the rig has stood for so long that its load may be another. What is collected ends; what of it
    is enough for a fit is fitted, with the rig as it was."""
    fitting: Fitting | None = None
    memory: Memory | None = None
    enabled: Callable[[Machine], bool] = lambda machine: True  # whether it runs with this machine file
    prepare: Callable[[Machine], None] = lambda machine: None  # compiles what `take` needs; changes nothing
    kernels: tuple[Kernel[..., Any], ...] = ()  # that `prepare` compiles
    learn: Callable[[Any, Any, Any], bool] | None = None
    """(state, job, result): take what a fit of another row has told, before that row adopts it. Returns
    whether a change of soil that it found was foreseen."""

    def rig_changed(self, state: Any) -> None:
        """What is collected is of another rig, as the machine was before: discard it and the pending fit, and
        keep what was learned."""
        self.clock_stepped(state, 0)


ESTIMATORS: tuple[Estimator, ...] = (
    Estimator(
        steady_state.METHOD,
        steady_state.SteadyState,
        steady_state.initial,
        steady_state.take,
        steady_state.estimate,
        steady_state.clock_stepped,
        steady_state.stood,
        memory=Memory(
            steady_state.STATES, ("slow_t", "slow_i"), learned.of_steady_state, learned.into_steady_state
        ),
        prepare=steady_outputs.prepare,
        kernels=steady_outputs.KERNELS,
    ),
    Estimator(
        tracker.METHOD,
        tracker.TrackerState,
        tracker.initial,
        tracker.take,
        tracker.estimate,
        tracker.clock_stepped,
        tracker.stood,
        memory=Memory(unknowns.NAMES, unknowns.NOISES, learned.of_tracker, learned.into_tracker),
        prepare=tracker.prepare,
        kernels=tracker.KERNELS,
        learn=tracker.learn,
    ),
    Estimator(
        pem.METHOD,
        pem.PemState,
        pem.initial,
        pem.take,
        pem.estimate,
        pem.clock_stepped,
        pem.stood,
        fitting=Fitting(
            pem.PEM.latency_ns,
            pem.request_fit,
            pem.fit,
            pem.rehearse,
            pem.adopt,
            pem.finish,
            propagation.rehearse,
        ),
        memory=Memory(unknowns.NAMES, unknowns.NOISES, learned.of_pem, learned.into_pem),
    ),
    Estimator(
        rows.METHOD,
        rows.RowsState,
        rows.initial,
        rows.take,
        rows.estimate,
        rows.clock_stepped,
        rows.stood,
        fitting=Fitting(
            rows.TUNING.latency_ns,
            rows.request_fit,
            rows.fit,
            rows.rehearse,
            rows.adopt,
            rows.finish,
            row_filter.rehearse,
            rows.tells_of_file,
        ),
        memory=Memory(unknowns.NAMES, unknowns.NOISES, learned.of_rows, learned.into_rows),
    ),
    Estimator(
        place.METHOD,
        place.PlaceState,
        place.initial,
        place.take,
        place.estimate,
        place.clock_stepped,
        memory=Memory(PARAMETERS, (), learned.of_place, learned.into_place),
        learn=place.learn,
    ),
    Estimator(
        two_step.METHOD,
        two_step.TwoStepState,
        two_step.initial,
        two_step.take,
        two_step.estimate,
        two_step.clock_stepped,
        two_step.finish,
        fitting=Fitting(
            two_step.TWO_STEP.latency_ns,
            two_step.request_fit,
            two_step.fit,
            two_step.rehearse,
            two_step.adopt,
            two_step.finish,
        ),
        enabled=lambda machine: machine.estimation.two_step,
        # No memory: 7.20 forgets nothing, so its merged values start again with each run.
    ),
)

ROW: dict[str, Estimator] = {row.method: row for row in ESTIMATORS}
FITTED: tuple[tuple[str, Fitting], ...] = tuple(
    (row.method, row.fitting) for row in ESTIMATORS if row.fitting is not None
)


def rows_for(machine: Machine) -> tuple[Estimator, ...]:
    """The rows that run on a machine, in order. The worker computes their fits in the same order."""
    return tuple(row for row in ESTIMATORS if row.enabled(machine))
