"""Under the recorder's own unit, with its filter of system calls: what is to stand behind it really does.

The computer is this one's kernel, in namespaces (contained.py), and by hand the virtual machine:
`pytest -m "vm or vm_systemd" -n 0 tests/vm/test_priorities.py`.
"""

import json
import sysconfig
from collections.abc import Callable, Sequence
from pathlib import Path

import contained
import guest
import pytest
from guest import CHECKOUT, HERE


def in_the_machine(scenario: Sequence[str], out: Path) -> None:
    with guest.boot(["bash", "-x", str(HERE / "with_systemd.sh"), *scenario], out) as machine:
        machine.finish()


@pytest.mark.parametrize(
    "run",
    [
        pytest.param(
            contained.with_systemd,
            marks=[pytest.mark.vm, pytest.mark.skipif(contained.missing() != "", reason=contained.missing())],
        ),
        pytest.param(
            in_the_machine,
            marks=[pytest.mark.vm_systemd, pytest.mark.skipif(guest.missing() != "", reason=guest.missing())],
        ),
    ],
)
def test_fits_reports_and_the_compiling_step_back_under_the_filter(
    run: Callable[[Sequence[str], Path], None], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    environment = ["env", f"CHECKOUT={CHECKOUT}", f"NEEDED={sysconfig.get_path('purelib')}"]
    run([*environment, "bash", "-ex", str(HERE / "priorities.sh")], out)
    errors = (out / "errors.txt").read_text()
    found = json.loads((out / "found.json").read_text() or "null")
    assert found is not None, errors
    assert found["recorder"] == -10 and found["said"] == []
    assert [found["fits"], found["compiling"], int(found["report"][0])] == found["wanted"]
    assert found["report"][1] == "1000"
    assert found["forward"] == "Permission denied"  # by the kernel: it has no capability
