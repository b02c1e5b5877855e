"""`tilth fit` over drives on different soil: no number beyond all segments, groups in its place."""

import json
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT
from recorded import shared_cache

import tilth.analysis
from tilth.analysis.fit.fitting import choose, fit_all
from tilth.analysis.validation.validate import hold_out
from tilth.cli import main
from tilth.schemas.flow import PARAMETERS

pytestmark = pytest.mark.long


def drive(folder: Path, name: str, seed: int, seconds: int) -> Path:
    log = folder / f"{name}.mcap"
    scenario = str(ROOT / "examples" / "scenarios" / f"{name}.toml")
    words = ["simulate", scenario, "--seed", str(seed), "--seconds", str(seconds), "--out", str(log)]
    assert main(words) == 0
    return log


def test_drives_on_different_soil_have_groups_and_no_number_beyond_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_cache()))
    logs = [drive(tmp_path, "random", 3, 40), drive(tmp_path, "soil_change", 4, 95)]
    capsys.readouterr()
    assert main(["fit", *map(str, logs), "--json"]) == 0
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert answer["agreement"]["p"] < 1e-4
    ids = [one["id"] for one in answer["runs"] if one["fitted_s"]]
    assert sorted(id for group in answer["groups"] for id in group["segments"]) == sorted(ids)
    for name in PARAMETERS:
        values = [one["parameters"][name]["value"] for one in answer["runs"]]
        known = [value for value in values if value is not None]
        joint = answer["joint"]["parameters"][name]
        assert joint["value"] is None or min(known) <= joint["value"] <= max(known)
    front = answer["joint"]["parameters"]["C_af"]
    assert front["value"] is None and "do not agree" in front["reason"]
    assert answer["groups"][0]["name"] in front["reason"]
    runs = tilth.analysis.open(logs)  # kept by the command
    (whole,) = [one for one in hold_out(fit_all(choose(runs))) if len(one.fitted) == len(ids)]
    assert whole.refused and not whole.cells
