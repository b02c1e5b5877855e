"""The CAN bring-up on real SocketCAN."""

from pathlib import Path

import pytest
from guest import boot, missing

pytestmark = [pytest.mark.vm, pytest.mark.skipif(missing() != "", reason=missing())]

BUSES = """
[[bus]]
name = "can0"
interface = "socketcan"
channel = "can0"
bitrate = 250000
"""


def test_can_is_brought_up_with_its_bit_rate_and_left_alone_when_it_is(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "machine.toml").write_text(
        "".join(BUSES.replace("can0", name) for name in ("can0", "can9", "vcan0"))
    )
    script = """
    up() { python3 -P deploy/can_up.py $1 $OUT/machine.toml; }
    up can0; ip -d link show can0 >$OUT/details
    ip link set can1 up type can bitrate 250000
    changes=/sys/class/net/can0/carrier_changes
    before=$(cat $changes); up can0; test $before = $(cat $changes)
    candump -n 1 can0 >$OUT/seen & until grep -q '^ *can0 ' /proc/net/can/rcvlist_all; do sleep 0.1; done
    cansend can1 123#11; wait
    ip link set can0 down; ip link set can0 type can bitrate 500000; up can0
    ip -d link show can0 | grep 'bitrate 250000'
    ip link add vcan0 type vcan; up vcan0; ip link show vcan0 | grep -w UP
    up can1 | grep 'left alone'
    if up can9; then exit 1; fi
    """
    with boot(["bash", "-exc", script], out) as guest:
        guest.finish()
        details = (out / "details").read_text()
        assert "bitrate 250000" in details and "restart-ms 100" in details and "qlen 1000" in details
        assert "123" in (out / "seen").read_text()


def test_without_a_machine_file_it_only_listens_and_with_one_it_takes_part(tmp_path: Path) -> None:
    """The emulated bus has no speed: the first bit rate is heard. It waits while nothing is sent."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "label.toml").write_text('code = "ABCD-2345"')
    script = """
    up() { python3 -P deploy/can_up.py $1 $OUT/machine.toml; }
    ip link set can1 up type can bitrate 250000
    up can0 >$OUT/said &
    until ip -d link show can0 | grep 'bitrate 500000'; do sleep 0.1; done
    (while [ ! -s $OUT/said ]; do cansend can1 123#11; sleep 0.3; done) & wait
    ip -d link show can0 >$OUT/listening
    echo "$BUSES" >$OUT/machine.toml; up can0
    ip -d link show can0 >$OUT/details
    """
    with boot(["env", f"BUSES={BUSES}", "bash", "-exc", script], out) as guest:
        guest.finish()
    assert "frames are heard at" in (out / "said").read_text()
    assert "LISTEN-ONLY" in (out / "listening").read_text()
    details = (out / "details").read_text()
    assert "LISTEN-ONLY" not in details and "bitrate 250000" in details and "restart-ms 100" in details
