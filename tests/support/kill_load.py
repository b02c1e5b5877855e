"""Records under load until it is killed, again and again: kill_load.py FOLDER SEED COUNT.

Each recording is a fork of this process, which has imported everything already. After each kill it says on a
line the folder's number, how many frames had been handed over, and when the last of them was and the kill.
"""

import mmap
import os
import select
import signal
import struct
import sys
import time
from pathlib import Path

import numpy as np
from paths import MACHINE_FILE

from tilth.logger.clock import Clock
from tilth.logger.log.run_log import Recording
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import MachineFile, parse_machine

SPACING_NS = 500_000
BEHIND_NS = 50_000_000  # time that a busy computer did not give to the loop makes no frames
SHARED = struct.Struct("<Q")  # frames handed over
TEXT = MACHINE_FILE.read_text()


def record(folder: Path, shared: mmap.mmap, frames: int, far: int) -> None:
    """Closes the descriptor `far` when so many frames have been handed over."""
    text = TEXT.replace("[log]", "[log]\nrotate_minutes = 0.01\nkeep_free_megabytes = 1\nchunk_kilobytes = 4")
    clock = Clock()
    recording = Recording(
        folder, MachineFile(parse_machine(text), text), clock, lambda *output: None, lambda: "{}"
    )
    next_ns = clock.t_ns()
    number = 0
    while True:
        now_ns = clock.t_ns()
        next_ns = max(next_ns, now_ns - BEHIND_NS)
        while next_ns <= now_ns:
            data = number.to_bytes(8, "little")
            recording.frame(Frame(next_ns, next_ns, "can0", 0x18FF0001, True, False, data))
            number += 1
            next_ns += SPACING_NS
        SHARED.pack_into(shared, 0, number)
        recording.tick(now_ns)
        if far and number >= frames:
            os.close(far)
            far = 0
        time.sleep(0.002)  # the pace of a loop


def main(folder: Path, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    for number in range(count):
        shared = mmap.mmap(-1, mmap.PAGESIZE)
        frames = int(rng.integers(3000))  # a busy computer takes longer to hand over so many
        near, far = os.pipe()
        child = os.fork()
        if child == 0:
            record(folder / f"{number:03d}", shared, frames, far)
        os.close(far)
        select.select([near], [], [], 60.0)
        time.sleep(rng.uniform(0.0, 0.1))  # the instant of the kill is a matter of chance
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(near)
        sys.stdout.write(f"{number} {SHARED.unpack_from(shared)[0]}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
