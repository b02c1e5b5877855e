"""The virtual machine itself: what every other test in it rests on."""

from pathlib import Path

import pytest
from guest import boot, missing

pytestmark = [pytest.mark.vm, pytest.mark.skipif(missing() != "", reason=missing())]


def test_frames_drives_and_the_exit_status(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    drive.write_bytes(b"from outside".ljust(1 << 20))
    script = """
    ip link add vcan0 type vcan && ip link set vcan0 up
    candump -L -n 3 vcan0 >$OUT/seen & until grep -q '^ *vcan0 ' /proc/net/can/rcvlist_all; do sleep 0.1; done
    cangen vcan0 -n 3 -I 123 -D 1122 -L 2; wait
    head -c 12 /dev/vda >$OUT/read && echo from inside | dd of=/dev/vda conv=fsync && exit 7
    """
    with boot(["bash", "-c", script], tmp_path / "out", drives=[drive]) as guest:
        with pytest.raises(AssertionError, match="exit status 7"):
            guest.finish()
        assert (guest.out / "seen").read_text().count(" vcan0 123#1122\n") == 3
        assert (guest.out / "read").read_text() == "from outside"
    assert drive.read_bytes().startswith(b"from inside\n")
