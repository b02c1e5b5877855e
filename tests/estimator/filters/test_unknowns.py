"""Rows of the unknowns: what they do to parameters, and that a new one is a row and a symbol."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contributing import DIFFS, changed
from logs import MACHINE
from paths import MACHINE_FILE, ROOT, SUPPORT

from tilth.deploy import codes_page, wire_page
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.propagation import P_GEOMETRY, set_parameters
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.models.parameters import GEOMETRY, geometry_of
from tilth.estimator.models.rolling_terms import CONSTANTS, PARAMETERS

EXAMPLE = next(diff for diff in DIFFS if diff.startswith("--- a/estimator/filters/unknowns.py\n"))
NEW = ("rate_scale_t", "rate_scale_i")
COPIED = ("estimator", "schemas", "deploy")


def _parameters(point: Any, linear: bool) -> tuple[Any, Any]:
    p, slopes = np.zeros(len(PARAMETERS) + len(CONSTANTS)), np.zeros(len(unknowns.ACTIONS))
    set_parameters.interpreted()(point, rig_setup(MACHINE, linear), p, slopes)
    return p, slopes


@pytest.mark.parametrize("linear", [False, True])
def test_what_an_unknown_does_to_a_parameter_has_the_slope_of_a_difference(linear: bool) -> None:
    mean, sd = unknowns.prior(MACHINE)
    point = mean + 0.3 * sd * np.random.default_rng(1).normal(size=len(mean))
    p, slopes = _parameters(point, linear)
    expected = np.zeros((len(point), len(p)))
    for one, slope in zip(unknowns.ACTIONS, slopes, strict=True):
        expected[one.unknown, one.parameter] = slope
    for k in range(len(point)):
        step = 1e-6 * np.eye(len(point))[k]
        more, less = _parameters(point + step, linear)[0], _parameters(point - step, linear)[0]
        np.testing.assert_allclose((more - less) / 2e-6, expected[k], rtol=1e-6, atol=1e-3)
    six = np.exp(point[unknowns.SIX])
    np.testing.assert_allclose(p[:6], six)
    shape = unknowns.geometry(geometry_of(MACHINE), point)
    np.testing.assert_array_equal(p[P_GEOMETRY:][: len(GEOMETRY)], shape)


def test_a_parameter_stays_above_its_least_value_and_has_no_slope_there() -> None:
    mean, _ = unknowns.prior(MACHINE)
    mean[unknowns.AT["roll_pin"]] = -9.0
    p, slopes = _parameters(mean, False)
    k = [one.unknown for one in unknowns.ACTIONS].index(unknowns.AT["roll_pin"])
    assert (p[PARAMETERS.index("pivot_height")], slopes[k]) == (0.0, 0.0)


# The example of CONTRIBUTING.


def _run(*words: object, path: Path | None = None) -> dict[str, list[list[float]]]:
    environment = os.environ | ({} if path is None else {"PYTHONPATH": str(path)})
    machine = MACHINE_FILE
    script = [sys.executable, str(SUPPORT / "short_run.py"), str(machine), *map(str, words)]
    found: dict[str, list[list[float]]] = json.loads(
        subprocess.run(script, env=environment, capture_output=True, check=True, text=True).stdout
    )
    return found


@pytest.fixture(scope="module")
def changed_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder to import tilth from, of a checkout with the example's unknowns, regenerated."""
    path = tmp_path_factory.mktemp("changed")
    tree = path / "tilth"
    for name in COPIED:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tree / "docs").mkdir()
    for name in ("pyproject.toml", "uv.lock", codes_page.TARGET, wire_page.TARGET):
        shutil.copy(ROOT / name, tree / name)
    for name, text in changed(EXAMPLE).items():
        (tree / name).write_text(text, encoding="utf-8")
    made = subprocess.run(
        [sys.executable, "-m", "tilth.deploy.generate"],
        env=os.environ | {"PYTHONPATH": str(path)}, capture_output=True, check=True, text=True,
    )  # fmt: skip
    assert re.findall(r"^(\S+): written$", made.stdout, re.M) == [
        "estimator/filters/generated/observation_kernels.py"
    ]
    return path


@pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv")
@pytest.mark.long
def test_a_new_unknown_is_a_row_and_a_symbol(changed_tree: Path) -> None:
    """Its slopes are those of differences; where it is nothing, all is as before."""
    after = _run(*NEW, "C_ar", "rate_late_t", path=changed_tree)
    before = _run("C_ar", "rate_late_t")
    assert (after["e"], after["S"]) == (before["e"], before["S"])
    # But for rounding: a matrix product of another width may be summed in another order.
    np.testing.assert_allclose(after["slopes"][2:], before["slopes"], rtol=1e-12, atol=1e-15)
    slopes, differences = (np.array(after[name][:2]) for name in ("slopes", "differences"))
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-9)
    assert (np.abs(slopes).max(axis=1) > 0.01).all()  # rad/s per logarithm: the yaw rates themselves
