"""Sends frames with their number to a bus until it is ended: `numbered_frames.py PORT FILE`.

FILE says how many, in 8 bytes.
"""

import itertools
import os
import sys
import time

GROUP = "239.74.163.2"
SPACING_S = 0.02


def main(port: str, path: str) -> None:
    sys.modules["asammdf"] = None  # type: ignore[assignment]  # it reads files, and takes a minute to load
    import can

    told = os.open(path, os.O_WRONLY | os.O_CREAT)
    with can.Bus(GROUP, interface="udp_multicast", port=int(port), hop_limit=0) as bus:
        for number in itertools.count():
            bus.send(can.Message(arbitration_id=0x18FF0001, data=number.to_bytes(8, "little")))
            os.pwrite(told, (number + 1).to_bytes(8, "little"), 0)
            time.sleep(SPACING_S)


if __name__ == "__main__":
    main(*sys.argv[1:])
