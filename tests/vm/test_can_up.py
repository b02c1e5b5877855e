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


def test_it_listens_until_there_is_a_machine_file_then_sets_bit_rates_and_leaves_alone_what_is_right(
    tmp_path: Path,
) -> None:
    """The emulated bus has no speed: the first bit rate is heard. It waits while nothing is sent."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "label.toml").write_text('code = "ABCD-2345"')
    script = """
    up() { python3 -P deploy/can_up.py $1 $OUT/machine.toml; }
    show() { ip -d link show can0; }
    ip link set can1 up type can bitrate 250000
    up can0 >$OUT/said &
    until show | grep 'bitrate 500000'; do sleep 0.1; done
    (while [ ! -s $OUT/said ]; do cansend can1 123#11; sleep 0.3; done) & wait
    show >$OUT/listening

    echo "$BUSES" >$OUT/machine.toml; up can0
    show >$OUT/details
    changes=/sys/class/net/can0/carrier_changes
    before=$(cat $changes); up can0; test $before = $(cat $changes)
    candump -n 1 can0 >$OUT/seen & until grep -q '^ *can0 ' /proc/net/can/rcvlist_all; do sleep 0.1; done
    cansend can1 123#11; wait
    ip link set can0 down; ip link set can0 type can bitrate 500000; up can0
    show | grep 'bitrate 250000'
    ip link add vcan0 type vcan; up vcan0; ip link show vcan0 | grep -w UP
    up can1 | grep 'left alone'
    if up can9; then exit 1; fi
    """
    buses = "".join(BUSES.replace("can0", name) for name in ("can0", "can9", "vcan0"))
    with boot(["env", f"BUSES={buses}", "bash", "-exc", script], out) as guest:
        guest.finish()
    assert "frames are heard at" in (out / "said").read_text()
    assert "LISTEN-ONLY" in (out / "listening").read_text()
    details = (out / "details").read_text()
    assert "LISTEN-ONLY" not in details and "bitrate 250000" in details
    assert "restart-ms 100" in details and "qlen 1000" in details
    assert "123" in (out / "seen").read_text()
