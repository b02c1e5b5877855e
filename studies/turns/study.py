"""Hard turns on uneven ground: what a noise model of its own makes of the windows of `pem`, beside the truth.

    uv run python -m studies.turns.study LOG... [--steps 3] [--path steering|filter] [--order-zero]

A log is one of `tilth simulate` with its truth beside it, or NAME.log.gz with NAME.toml and NAME.truth.json.
The windows are fitted by `pem` as live. Then all of them are one problem: Gauss and Newton's steps from where
`pem` ended, with the prior once, and with noise levels and roll modes as `pem` found them.
Printed: error and sd of the six logarithms in %, error in sds, of `pem` and after each step.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.rows.study import opened
from tilth.analysis.runs.driven import Driven
from tilth.analysis.runs.driving import driving
from tilth.estimator.filters import likelihood, scoring, unknowns
from tilth.estimator.filters.contrast import MOTION, ToldOfMotion, told_beside
from tilth.estimator.filters.likelihood import Search, inverse
from tilth.estimator.filters.newton import newton_step
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import NOISE, SIX
from tilth.estimator.methods import pem
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


class TurnWindow(NamedTuple):
    search: Search
    noise: Array  # noise levels that `pem` found


def fitted(machine: Machine, given: Sequence[Driven]) -> tuple[pem.PemState, list[TurnWindow]]:
    """What `pem` learned of a drive, each fit made when it is asked for, and its windows."""
    state, windows = pem.initial(machine), list[TurnWindow]()

    def fit_now(t_ns: int) -> None:
        job = pem.request_fit(state, t_ns)
        if job is None:
            return
        made = pem.fit(machine, job)
        pem.adopt(state, machine, made, t_ns)
        if made.refused is None:
            mean, sd = unknowns.prior(machine)
            known = pem.with_known_masses(np.diag(sd**2))
            search = likelihood.search_of(job.record, rig_setup(machine), mean, known)
            scoring.leave_out_outliers(search, made.mean)
            windows.append(TurnWindow(search, made.mean[NOISE]))

    for one in given:
        pem.take(state, machine, one.pose, one.segment)
        fit_now(one.t_ns)
    pem.finish(state)
    fit_now(given[-1].t_ns)
    return state, windows


def told_by(search: Search, point: Array, *, steered: bool, past: bool) -> ToldOfMotion:
    """At a point, (n,), with the noise levels there. steered: slopes along the path that the steering alone
    gives, else along the filter's."""
    if steered:
        places = search.active[search.of_motion]
        return told_beside(search, *likelihood.whitened_by_steering(search, point, places), past)
    at = likelihood.evaluate(search, point)
    weights = search.scored / np.sqrt(at.S)
    return told_beside(search, at.e * weights, (at.de[search.of_motion] * weights).T, past)


def step(
    machine: Machine,
    state: pem.PemState,
    windows: Sequence[TurnWindow],
    point: Array,
    *,
    steered: bool,
    past: bool,
) -> tuple[Array, Array]:
    """(the point after a step of Gauss and Newton, its sds of the six with what is not known of the masses
    and of the model)."""
    mean, sd = unknowns.prior(machine)
    places = np.intersect1d(windows[0].search.active, MOTION)
    roll = np.isin(places, likelihood.ROLL_MODES)
    before, middle = np.diag(sd[places] ** 2), mean[places]
    before[np.ix_(roll, roll)] = state.covariance[np.ix_(places[roll], places[roll])]
    middle[roll] = state.mean[places[roll]]
    known = inverse(before)
    gradient, information = known @ (point[places] - middle), known.copy()
    for search, noise in windows:
        here = point.copy()
        here[NOISE] = noise
        told = told_by(search, here, steered=steered, past=past)
        gradient, information = gradient + told.gradient, information + told.information
    change, sds = newton_step(gradient, information)
    there = point.copy()
    there[places] += change
    masses = np.diag(pem.of_masses(np.diag(sd**2)))[SIX]
    return there, np.sqrt(sds[SIX] ** 2 + masses + state.model_sd**2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--path", choices=("steering", "filter"), default="steering", help="of the slopes")
    parser.add_argument("--order-zero", action="store_true", help="without the past")
    args = parser.parse_args()
    ratios: dict[int, list[Array]] = {}
    for log in args.logs:
        run, true = opened(log)
        state, windows = fitted(run.machine, driving(run))
        if not windows:
            print(f"{log.name}: no window was fitted", flush=True)
            continue
        point, sds = state.mean, np.sqrt(np.diag(state.covariance)[SIX])
        for k in range(args.steps + 1):
            errors = point[SIX] - true
            told = "  ".join(
                f"{100 * e:+.0f} ({100 * s:.0f}; {e / s:+.1f})" for e, s in zip(errors, sds, strict=True)
            )
            print(f"{log.name}, {f'step {k}' if k else 'pem'}: {told}", flush=True)
            ratios.setdefault(k, []).append(errors / sds)
            if k < args.steps:
                steered = args.path == "steering"
                point, sds = step(
                    run.machine, state, windows, point, steered=steered, past=not args.order_zero
                )
    for k, some in ratios.items():
        size = np.abs(some)
        print(f"{f'step {k}' if k else 'pem'}: {int(np.sum(size < 1.96))} of {size.size} hold", flush=True)


if __name__ == "__main__":
    main()
