"""Two answers of a fit, compared number by number."""

import copy
import json
import math
from dataclasses import asdict

import numpy as np
import pytest
from fit_answer import answer

from tilth.analysis.fit.compare import NotComparable, compare
from tilth.schemas.flow import PARAMETERS


def test_a_wheel_zero_that_moved_is_told() -> None:
    moved = answer()
    moved["joint"]["nuisances"]["wheel_zero"]["value"] = 0.05
    found = compare(answer(), moved)
    assert found.differ and "when straight (wheel_zero) from 0.573 ° to 2.86 °" in found.sentence
    assert found.p > 0.9 and json.dumps(asdict(found))


def test_chance_alone_is_seldom_taken_for_a_difference() -> None:
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(400):
        values = {name: math.exp(0.1 * rng.normal()) * answer()["joint"]["parameters"][name]["value"]
                  for name in PARAMETERS}  # fmt: skip
        others = {name: math.exp(0.1 * rng.normal()) * answer()["joint"]["parameters"][name]["value"]
                  for name in PARAMETERS}  # fmt: skip
        alarms += compare(answer(values), answer(others)).differ
    assert alarms <= 14  # 2 % at most are wanted: each alone, and all together


def test_what_only_one_gives_is_named() -> None:
    partly = copy.deepcopy(answer())
    partly["joint"]["parameters"]["sigma_i"]["value"] = None
    found = compare(answer(), partly)
    assert found.missing == ("sigma_i",) and found.dof == 5
    with pytest.raises(NotComparable, match="the second has no joint estimate"):
        compare(answer(), answer() | {"joint": None})


def test_what_has_no_joint_number_says_why() -> None:
    other = answer()
    for row in other["joint"]["parameters"].values():
        row |= {"value": None, "sd": None, "status": "unestimated", "reason": "the segments do not agree"}
    found = compare(answer(), other)
    assert found.dof == 0 and "(the segments do not agree)" in found.sentence and len(found.missing) == 6


def test_one_drive_beside_itself_is_named() -> None:
    found = compare(answer(), answer())
    assert not found.differ and "they are of one drive" in found.sentence
