"""What is known of a rig's parameters, and how well: by its machine file, by a log's estimates, as given.

All parameters are above zero and are taken as log-normal, as estimates are published.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.report.curves import column_of
from tilth.analysis.runs.run import RECOMMENDED, Run
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


class Knowledge(NamedTuple):
    """Of the parameters that are not known exactly; all else is as the rig has it."""

    source: str  # in words
    rig: Rig  # at the medians
    names: tuple[str, ...]
    log_covariance: Array  # (k, k), of the natural logarithms

    @property
    def median(self) -> Array:
        """Values of the names, SI, (k,)."""
        return np.array([getattr(self.rig, name) for name in self.names])

    @property
    def log_sd(self) -> Array:
        """Standard deviations of the natural logarithms, (k,)."""
        return np.sqrt(np.diag(self.log_covariance))


def of_machine(machine: Machine) -> Knowledge:
    """The machine file's values and standard deviations, independent of each other."""
    rig = rig_of(machine)
    sds = {name: sd for name, sd in _machine_sds(machine).items() if sd > 0}
    return Knowledge("the machine file", rig, tuple(sds), np.diag(np.array(list(sds.values())) ** 2))


def _machine_sds(machine: Machine) -> dict[str, float]:
    """Parameter -> standard deviation of its logarithm."""
    tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)
    tractor, implement = machine.tractor, machine.implement
    quantities = (
        tractor.a, tractor.b, tractor.c, implement.d, implement.e, tractor.mass, implement.mass,
        tractor.yaw_inertia, implement.yaw_inertia, tractor.cg_height, implement.cg_height,
    )  # fmt: skip
    surveyed = [math.sqrt(math.log1p((q.sd / q.value) ** 2)) if q.value > 0 else 0.0 for q in quantities]
    return dict(zip(MACHINE_PARAMETERS, [*(tyre.log_sd for tyre in tyres * 2), *surveyed], strict=True))


def of_run(run: Run) -> Knowledge:
    """The last recommended estimate of a run with its covariance, and the machine file's word for the rest.

    Raises ValueError, a sentence, where the run has no estimate that may be used.
    """
    table = run.estimates(RECOMMENDED)
    if not table.rows:
        raise ValueError(f"there are no estimates in {run.id}; `tilth replay` makes them")
    status = [int(table[column_of(name, "status")][-1]) for name in PARAMETERS]
    bad = [name for name, one in zip(PARAMETERS, status, strict=True) if one != Status.ESTIMATED]
    covariance = np.asarray(table["log_covariance"][-1], dtype=np.float64).reshape(6, 6)
    if bad or not np.all(np.isfinite(covariance)):
        raise ValueError(
            f"at the end of {run.id} there is no estimate of {', '.join(bad) or 'all six together'} that may "
            "be used; give a run with more steering, or --sd"
        )
    base = of_machine(run.machine)
    values = [float(table[column_of(name)][-1]) for name in PARAMETERS]
    rest = [k for k, name in enumerate(base.names) if name not in PARAMETERS]
    whole = np.zeros((6 + len(rest), 6 + len(rest)))
    whole[:6, :6] = covariance
    whole[6:, 6:] = base.log_covariance[np.ix_(rest, rest)]
    return Knowledge(
        f"the estimates at the end of {run.id}",
        base.rig._replace(**dict(zip(PARAMETERS, values, strict=True))),
        (*PARAMETERS, *(base.names[k] for k in rest)),
        whole,
    )


def given(
    base: Knowledge, log_sds: Mapping[str, float], correlations: Sequence[tuple[str, str, float]] = ()
) -> Knowledge:
    """Only what is named is not known, so well. Raises ValueError where correlations do not fit together."""
    names = tuple(log_sds)
    correlation = np.eye(len(names))
    for one, other, value in correlations:
        j, k = names.index(one), names.index(other)
        correlation[j, k] = correlation[k, j] = value
    sds = np.array(list(log_sds.values()))
    if np.linalg.eigvalsh(correlation)[0] <= 0:
        raise ValueError(
            "--correlation: these cannot all be true of the same parameters (their covariance is not "
            "positive definite); make some smaller"
        )
    return Knowledge("--sd", base.rig, names, correlation * np.outer(sds, sds))
