"""`tilth compare`: what is the same stays within chance, another soil does not; what cannot be compared."""

import copy
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import marked, recorded, shared_cache

from tilth.analysis.fit.compare import NotComparable, as_json, compare
from tilth.cli import main
from tilth.schemas.flow import PARAMETERS

Answer = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Answer:
    """(status, stdout, stderr) of `tilth …`."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_cache()))

    def of(*words: str | Path) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return status, out, err

    return of


def answer(values: dict[str, float] | None = None, sd: float = 0.1) -> dict[str, Any]:
    """What `tilth fit --json` might give. sd: of each logarithm."""
    given = {"C_af": 2e5, "C_ar": 5e5, "C_ai": 1.7e5, "sigma_f": 1.0, "sigma_r": 1.5, "sigma_i": 1.0}
    given |= values or {}
    parameters = {name: {"value": given[name], "sd": sd * given[name], "status": "estimated", "reason": ""}
                  for name in PARAMETERS}  # fmt: skip
    covariance = (sd**2 * np.eye(6)).tolist()
    nuisances = {"wheel_zero": {"value": 0.01, "sd": 0.002}}
    return {
        "runs": [],
        "joint": {"parameters": parameters, "log_covariance": covariance, "nuisances": nuisances},
    }


def test_nothing_differs_between_a_log_and_itself(call: Answer, tmp_path: Path) -> None:
    status, out, _ = call("fit", recorded().parts[0], "--json")
    saved = tmp_path / "fit.json"
    saved.write_text(out)
    assert status == 0
    status, out, _ = call("compare", recorded().parts[0], saved, "--json")
    found = json.loads(out)
    assert status == 0 and found["chi2"] == 0.0 and "Nothing differs beyond chance" in found["sentence"]
    status, out, _ = call("compare", recorded().parts[0], marked())  # of which only one step is marked
    assert status == 0 and "C_af" in out


def test_another_soil_is_told(call: Answer, tmp_path: Path) -> None:
    paths = [tmp_path / "a.json", tmp_path / "b.json"]
    for path, found in zip(paths, (answer(), answer({"C_af": 1e5})), strict=True):
        path.write_text(json.dumps(found))
    status, out, _ = call("compare", *paths)
    assert status == 1 and "C_af × 0.50 (0.38 to 0.66)" in " ".join(out.split())


def test_a_wheel_zero_that_moved_is_told() -> None:
    moved = answer()
    moved["joint"]["nuisances"]["wheel_zero"]["value"] = 0.05
    found = compare(answer(), moved)
    assert found.differ and "wheel_zero from 0.01 to 0.05" in found.sentence
    assert found.p > 0.9 and json.dumps(as_json(found))


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
        compare(answer(), {"runs": [], "joint": None})


def test_what_cannot_be_compared(call: Answer, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("[1, 2")
    good = tmp_path / "good.json"
    good.write_text(json.dumps(answer()))
    for words, says in (
        ((wrong, good), "not what `tilth fit --json` writes"),
        ((good, tmp_path / "no.mcap"), "no such file"),
        ((good, good, "--machine", "a", "--machine", "b", "--machine", "c"), "once for both, or twice"),
    ):
        status, _, err = call("compare", *words)
        assert status == 2 and says in err


def test_what_has_no_joint_number_says_why() -> None:
    other = answer()
    for row in other["joint"]["parameters"].values():
        row |= {"value": None, "sd": None, "status": "unestimated", "reason": "the segments do not agree"}
    found = compare(answer(), other)
    assert found.dof == 0 and "(the segments do not agree)" in found.sentence and len(found.missing) == 6
