"""A log says what computed it; another processor is told from this one whatever it calls itself."""

import json
import subprocess
import sys

import pytest
from disguise import disguised

from tilth.logger.log.software import OF_NUMBERS, computed_elsewhere, software
from tilth.schemas.readable import readable


def told(environment: dict[str, str]) -> dict[str, str]:
    text = "import json; from tilth.logger.log.software import software; print(json.dumps(software()))"
    done = subprocess.run(
        [sys.executable, "-c", text], env=environment, check=True, capture_output=True, text=True
    )
    found: dict[str, str] = json.loads(done.stdout)
    return found


def test_what_computes_is_told_with_versions() -> None:
    here = software()
    assert all(here[key] and readable(here[key]) == here[key] for key in OF_NUMBERS)
    assert "openblas" in here["blas"] and here["numba"][0].isdigit() and here["processor"]
    assert computed_elsewhere(here) == "" == computed_elsewhere({})
    older = {key: text for key, text in here.items() if key not in ("arithmetic", "blas", "libc", "numba")}
    assert computed_elsewhere(older) == ""


@pytest.mark.parametrize("key", OF_NUMBERS)
def test_another_of_anything_that_rounds_is_elsewhere(key: str) -> None:
    assert f"banana, here {software()[key]}" in computed_elsewhere(software() | {key: "banana"})


@pytest.mark.skipif(software()["processor"] != "x86_64", reason="the disguises are of x86-64")
@pytest.mark.parametrize("name", ["another BLAS kernel", "no fused multiply-add"])
def test_another_processor_is_told_from_this_one_in_the_same_process_twice(name: str) -> None:
    plain, one = told(disguised("no AVX-512")), told(disguised(name))
    assert plain["arithmetic"] != one["arithmetic"] and len(one["arithmetic"]) == 12
