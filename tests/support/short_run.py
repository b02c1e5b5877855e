"""A short run of the filter, interpreted: `python short_run.py UNKNOWN…` prints its innovations, their
variances, and for each unknown their slopes in the open loop, by the filter and by differences, as JSON."""

import json
import os
import sys
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.predictor import Innovations
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.record.record import Record
from tilth.estimator.results.advice import planned_rows
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]
TICKS = 40


def main(machine_file: str, names: list[str]) -> dict[str, list[list[float]]]:
    """What is printed."""
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # before numba is imported
    machine = Machine.model_validate(tomllib.loads(Path(machine_file).read_text(encoding="utf-8")))
    setup, (mean, _) = rig_setup(machine), unknowns.prior(machine)
    ticks = np.zeros((TICKS, 8))
    ticks[:, 0], ticks[:, 1] = 0.01 * np.arange(TICKS), 4.0
    record = Record(0, ticks, planned_rows(machine, TICKS, (10.0,) * 4))
    places = np.array([unknowns.AT[name] for name in names], dtype=np.int64)

    def run(point: Array, closed: bool) -> Innovations:
        return likelihood.innovations(record, setup, np.zeros(N_STATES), point, places, closed=closed)

    steps = 1e-4 * np.eye(len(mean))[places]
    found = [run(mean + step, False).e - run(mean - step, False).e for step in steps]
    whole = run(mean, True)
    return {
        "e": [whole.e.tolist()], "S": [whole.S.tolist()],
        "slopes": run(mean, False).de.T.tolist(), "differences": [(one / 2e-4).tolist() for one in found],
    }  # fmt: skip


if __name__ == "__main__":
    json.dump(main(sys.argv[1], sys.argv[2:]), sys.stdout)
