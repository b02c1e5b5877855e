"""Under the recorder's own unit, with its filter of system calls: what is to stand behind it really does."""

import json
import sysconfig
from pathlib import Path

import pytest
from guest import CHECKOUT, boot, missing

pytestmark = [pytest.mark.vm, pytest.mark.skipif(missing() != "", reason=missing())]

HERE = Path(__file__).parent


def test_fits_reports_and_the_compiling_step_back_under_the_filter(tmp_path: Path) -> None:
    out = tmp_path / "out"
    environment = ["env", f"CHECKOUT={CHECKOUT}", f"NEEDED={sysconfig.get_path('purelib')}"]
    command = ["bash", "-x", str(HERE / "with_systemd.sh"), *environment]
    with boot([*command, "bash", "-ex", str(HERE / "priorities.sh")], out) as guest:
        guest.finish()
    errors = (out / "errors.txt").read_text()
    found = json.loads((out / "found.json").read_text() or "null")
    assert found is not None, errors
    assert found["recorder"] == -10 and found["said"] == []
    assert [found["fits"], found["compiling"], int(found["report"][0])] == found["wanted"]
    assert found["report"][1] == "1000"
    assert found["forward"] == "Permission denied"  # by the kernel: it has no capability
