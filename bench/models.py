"""How fast the models run, beside what one would write with numpy or scipy alone.

    python bench/models.py

30 s of driving at 50 samples a second, from the same rig, inputs and start. All ways run in turn, the best
of several rounds counts. The last part starts fresh interpreters and so tells what compiled code kept on disk
saves.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from timing import best

from tilth.estimator.models import linear_analysis as la
from tilth.estimator.models import nonlinear
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.family import MODELS, Model
from tilth.estimator.models.parameters import TABLE_5_1

Array = NDArray[np.float64]

RIG = TABLE_5_1
SPEED, DT, N = 4.5, 0.02, 1500
ROUNDS = 7
TIME: Array = np.arange(N, dtype=np.float64) * DT
DELTA: Array = np.radians(8.0) * np.sin(2.0 * TIME)

START = """
import time
began = time.perf_counter()
from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import TABLE_5_1
imported = time.perf_counter()
nonlinear.simulate(TABLE_5_1, nonlinear.inputs_of(1500, delta=0.1, speed=4.5), nonlinear.running(4.5), 0.02)
print(imported - began, time.perf_counter() - imported, nonlinear.integrate.how)
"""


def main() -> None:
    print(f"{N * DT:g} s at {1 / DT:g} samples/s; best of {ROUNDS}")
    print(f"{'':44} {'ms':>9} {'ratio':>8}")
    for model in MODELS[:3]:
        compare(linear_ways(model))
    compare(nonlinear_ways())
    starts()


def compare(ways: dict[str, Callable[[], object]]) -> None:
    """Print each way's time, and how many times the first one's it is."""
    first = 0.0
    for name, way in ways.items():
        way()  # compiled
        seconds = best(way, ROUNDS if "solve_ivp" not in name else 2)
        first = first or seconds
        print(f"{name:44} {1e3 * seconds:9.3f} {seconds / first:8.1f}")


def linear_ways(model: Model) -> dict[str, Callable[[], object]]:
    inputs = np.column_stack([DELTA, np.zeros((N, 2))])
    x0 = np.zeros(len(model.states))
    wander = SPEED + 0.1 * np.sin(0.3 * TIME)

    def loop() -> Array:
        a, b = model.matrices(RIG, SPEED)
        f, g0, g1 = la.discretise(a, b, DT)
        g, x, states = g0 + g1, x0, np.zeros((N + 1, len(x0)))
        for k in range(N):
            x = f @ x + g @ inputs[k]
            states[k + 1] = x
        return states

    def solver() -> object:
        a, b = model.matrices(RIG, SPEED)

        def rate(t: float, x: Array) -> Array:
            return np.asarray(a @ x + b @ inputs[min(int(t / DT), N - 1)])

        return solve_ivp(rate, (0, N * DT), x0, max_step=DT, rtol=1e-6)

    return {
        f"{model.name}: simulate": lambda: la.simulate(model, RIG, SPEED, inputs, x0, DT),
        f"{model.name}: simulate, varying speed": lambda: la.simulate(model, RIG, wander, inputs, x0, DT),
        f"{model.name}: a numpy loop": loop,
        f"{model.name}: scipy solve_ivp": solver,
    }


def nonlinear_ways() -> dict[str, Callable[[], object]]:
    inputs, x0 = nonlinear.inputs_of(N, delta=DELTA, speed=SPEED), nonlinear.running(SPEED)

    def stepwise() -> None:
        x = x0
        for k in range(N):
            x = nonlinear.simulate(RIG, inputs[k : k + 1], x, DT, actuator=BOSSERD)[-1]

    def interpreted() -> None:
        states = np.zeros((N + 1, len(x0)))
        states[0] = x0
        nonlinear.integrate.interpreted()(states, inputs, RIG.theta[None], RIG, (0.0, 0.0), DT / 2, 2, False)

    def solver() -> object:
        def rate(t: float, x: Array) -> Array:
            return nonlinear.derivative(RIG, x, inputs[min(int(t / DT), N - 1)])

        return solve_ivp(rate, (0, N * DT), x0, max_step=DT, rtol=1e-6)

    return {
        "nonlinear: simulate": lambda: nonlinear.simulate(RIG, inputs, x0, DT),
        "nonlinear: simulate, a call for each sample": stepwise,
        "nonlinear: the same kernel, interpreted": interpreted,
        "nonlinear: scipy solve_ivp, interpreted": solver,
    }


def starts() -> None:
    """Import and first call in fresh interpreters that may keep what they compile, Python's own code too."""
    print(f"\n{'start of an interpreter, nonlinear model':44} {'import s':>9} {'first s':>8}")
    with tempfile.TemporaryDirectory() as folder:
        env = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        env |= {"NUMBA_CACHE_DIR": folder, "PYTHONPYCACHEPREFIX": folder}
        for name in ("first ever", "second", "third"):
            run = subprocess.run(
                [sys.executable, "-c", START], env=env, capture_output=True, text=True, check=True
            )
            imported, first, how = run.stdout.split(maxsplit=2)
            print(f"{name:44} {float(imported):9.2f} {float(first):8.2f}  {how.strip()}")


if __name__ == "__main__":
    main()
