"""A log is verified on a computer that rounds otherwise: in processes that disguise themselves as one."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from disguise import DISGUISES, MUSL, disguised
from logs import MACHINE, Live, altered, record
from paths import ROOT

from tilth.logger.log.software import software
from tilth.simulator.drive import drive
from tilth.simulator.scenario import parse_scenario
from tilth.simulator.traffic import simulate, traffic

pytestmark = pytest.mark.skipif(software()["processor"] != "x86_64", reason="the disguises are of x86-64")
FIELD_S = 160.0  # two fits of pem, and what follows
WHOLE_FIELD_S = 1200.0
ONE = "no fused multiply-add"  # the others by `-m long`, below


def verified(path: Path, disguise: str) -> tuple[int, dict[str, Any]]:
    """Status and answer of `tilth replay --verify`."""
    if disguise == "another libm" and not (MUSL.exists() and shutil.which("gcc")):
        pytest.skip("no musl: apt-get install gcc musl-dev")
    words = [sys.executable, "-m", "tilth.cli", "replay", "--verify", "--json", str(path)]
    done = subprocess.run(words, env=disguised(disguise), check=False, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    found: dict[str, Any] = json.loads(done.stdout)["verify"]
    return done.returncode, found


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Live:
    return record(tmp_path_factory.mktemp("live"), list(simulate(MACHINE, 3, 30.0)), 1)


@pytest.mark.parametrize("disguise", [ONE])
def test_elsewhere_all_is_equal_within_the_tolerances(live: Live, disguise: str) -> None:
    status, found = verified(live.parts[0], disguise)
    assert (status, found["difference"], found["compared"]) == (0, None, live.results)
    assert "arithmetic" in found["recorded_elsewhere"]
    assert found["to_the_byte"] < found["compared"]
    assert 0.0 < found["largest"]["amount"] < found["largest"]["tolerance"]


@pytest.mark.long
def test_elsewhere_what_is_missing_or_of_another_time_stays_a_difference(live: Live, tmp_path: Path) -> None:
    status, found = verified(altered(live, tmp_path, "/pose", 40, "missing"), ONE)
    assert status == 1 and found["difference"].startswith("/pose: ")


@pytest.fixture(scope="module")
def longer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Live:
    """With fits. A millionth in the first was 0.6 % of C_af in the second before a replay went on from what
    was logged."""
    scenario = parse_scenario((ROOT / "examples" / "scenarios" / "field_day.toml").read_text("utf-8"))
    rows = list(traffic(MACHINE, drive(MACHINE, 1, request.param, scenario)))
    return record(tmp_path_factory.mktemp("longer"), rows, 1)


@pytest.mark.parametrize(
    "longer",
    [
        pytest.param(FIELD_S, marks=pytest.mark.long),
        pytest.param(WHOLE_FIELD_S, marks=pytest.mark.elsewhere),
    ],
    indirect=True,
)
@pytest.mark.parametrize("disguise", DISGUISES)
def test_a_drive_with_fits_is_the_same_everywhere(
    longer: Live, disguise: str, record_property: Callable[[str, object], None]
) -> None:
    """`--junitxml FILE` has what each differs by."""
    status, found = verified(longer.parts[0], disguise)
    record_property("verify", found)
    assert (status, found["difference"], found["compared"]) == (0, None, longer.results)
