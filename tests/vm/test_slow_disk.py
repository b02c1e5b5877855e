"""A file system that takes no write for eight seconds: no frame is lost, and it is said."""

import json
from pathlib import Path

import pytest
from guest import CHECKOUT, boot, missing
from loopback import logged_frames

pytestmark = [pytest.mark.vm, pytest.mark.skipif(missing() != "", reason=missing())]


def test_writes_that_stall_for_seconds_cost_no_frame(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    drive.write_bytes(bytes(48 << 20))
    script = f"""
    mkfs.ext4 -q /dev/vda && mkdir /mnt/disk && mount /dev/vda /mnt/disk && mkdir /mnt/disk/logs
    python {CHECKOUT}/tests/vm/write_load.py /mnt/disk/logs >$OUT/told & job=$!
    until [ "$(cat /mnt/disk/logs/*.mcap 2>/dev/null | wc -c)" -gt 30000 ]; do sleep 0.2; done
    fsfreeze -f /mnt/disk; sleep 8; fsfreeze -u /mnt/disk; sleep 3; touch /mnt/disk/stop
    wait $job; cp /mnt/disk/logs/*.mcap $OUT
    """
    with boot(["bash", "-ec", script], tmp_path / "out", drives=[drive]) as guest:
        guest.finish()
    output = json.loads((guest.out / "told").read_text())
    assert output["given"] == output["recorded"] > 5000 and output["missed"] == 0
    assert any("has not answered for" in problem for problem in output["said"]), output
    paths = sorted(guest.out.glob("*.mcap"))
    numbers = [int.from_bytes(frame.data, "little") for path in paths for frame in logged_frames(path)]
    assert numbers == list(range(output["given"])) and len(paths) > 1
