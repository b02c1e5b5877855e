"""Kernels: the same equations compiled, interpreted, and where numba cannot do its work."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tilth.estimator.compiled import InterpretedWarning, Kernel
from tilth.estimator.models import linear_analysis, nonlinear
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.parameters import TABLE_5_1


def _run(integrate: Callable[..., None]) -> np.ndarray:
    states = np.zeros((31, 13))
    states[0] = nonlinear.running(4.5, v=0.2, psi_t=0.3)
    inputs = nonlinear.inputs_of(31, command=np.linspace(0, 0.5, 31), speed=5.0, gravity_t=0.3, force_i=500.0)
    act = (BOSSERD.gain, BOSSERD.damping)
    integrate(states, inputs, TABLE_5_1.theta[None], TABLE_5_1, act, 0.01, 2, True)
    return states


def test_compiled_and_interpreted_agree() -> None:
    np.testing.assert_allclose(
        _run(nonlinear.integrate), _run(nonlinear.integrate.interpreted()), rtol=1e-12, atol=1e-13
    )
    assert nonlinear.integrate.how == "compiled and kept"


def test_the_scan_agrees_too() -> None:
    rng = np.random.default_rng(0)
    f, g, forcing = rng.normal(0, 0.4, (3, 4, 4)), rng.normal(0, 1, (3, 4, 2)), rng.normal(0, 1, (20, 2))
    which, share = rng.integers(0, 2, 20), rng.uniform(0, 1, 20)
    one, other = np.ones((21, 4)), np.ones((21, 4))
    linear_analysis.scan(f, g, which, share, forcing, one)
    linear_analysis.scan.interpreted()(f, g, which, share, forcing, other)
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_without_numba_it_still_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)  # an import of it fails
    fresh: Kernel[Any, Any] = Kernel(nonlinear.integrate.function)
    np.testing.assert_allclose(_run(fresh), _run(nonlinear.integrate), rtol=1e-12, atol=1e-13)
    assert fresh.how.startswith("interpreted: ")


def test_without_a_place_to_keep_it_the_kernel_is_compiled_all_the_same() -> None:
    scope: dict[str, Any] = {"__name__": "typed_in"}
    exec("def double(x):\n    return 2.0 * x", scope)  # it has no file, so nothing can lie beside it
    fresh: Kernel[Any, Any] = Kernel(scope["double"])
    assert fresh(1.5) == 3.0
    assert fresh.how == "compiled"


def _unfit(x: float) -> float:
    return float({"value": [x]}["value"][0]) + len(f"{object()!r}") * 0.0


def test_what_cannot_be_compiled_is_interpreted_and_says_so() -> None:
    """In tests, where warnings are errors, nothing is ever interpreted for minutes unnoticed."""
    fresh: Kernel[Any, Any] = Kernel(_unfit)
    with pytest.warns(InterpretedWarning, match=r"_unfit is interpreted: \w+Error"):
        assert fresh(1.5) == 1.5
    assert fresh.how.startswith("interpreted: ")
    assert fresh(2.5) == 2.5


def test_a_mistake_in_the_arguments_is_not_hidden() -> None:
    def refuse(x: float) -> float:
        if x < 0.0:
            raise ValueError("below zero")
        return x

    with pytest.raises(ValueError, match="below zero"):
        Kernel(refuse)(-1.0)


def test_neither_fold_nor_models_import_numba() -> None:
    code = (
        "import sys, tilth.estimator.fold, tilth.estimator.models.regulator; sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
