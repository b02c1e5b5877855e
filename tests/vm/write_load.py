"""In the guest: a recording under load. Beside it a sector of the drive says how many frames there were.

write_load.py FOLDER SECTOR: frames a millisecond apart, numbered, into FOLDER; their count into the block
device SECTOR, past every cache, so that the order of what reaches the drive tells when a write was made.
write_load.py FOLDER: until a file FOLDER/../stop is there and there are ENOUGH; then it says in JSON what
became of the frames.
"""

import json
import mmap
import os
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NOW = struct.Struct("<8sQ")  # MARK, frames so far
MARK = b"TilthNow"
SPACING_NS = 1_000_000
ENOUGH = 6000  # a busy computer takes longer
BEHIND_NS = 20_000_000  # time that a busy computer did not give to the loop makes no frames


def main(folder: Path, sector: str = "") -> None:
    from tilth.logger.clock import Clock
    from tilth.logger.log.run_log import Recording
    from tilth.schemas.flow import Frame
    from tilth.schemas.machine_toml import MachineFile, parse_machine

    text = (ROOT / "deploy/machines/jd7930-parker500.toml").read_text()
    text = text.replace("[log]", "[log]\nrotate_minutes = 0.1\nkeep_free_megabytes = 1\nchunk_kilobytes = 16")
    machine = parse_machine(text)
    clock = Clock()
    number = 0
    recording = Recording(folder, MachineFile(machine, text), clock, lambda *output: None, lambda: "{}")
    if sector:
        threading.Thread(target=tell, args=(sector, lambda: number), daemon=True).start()
    next_ns = clock.t_ns()
    output = set[str]()
    while sector or number < ENOUGH or not (folder.parent / "stop").exists():
        now_ns = clock.t_ns()
        next_ns = max(next_ns, now_ns - BEHIND_NS)
        while next_ns <= now_ns:
            data = number.to_bytes(8, "little")
            recording.frame(Frame(next_ns, next_ns, "can0", 0x18FF0001, True, False, data))
            next_ns += SPACING_NS
            number += 1
        recording.tick(now_ns)
        output.add(recording.problem)
        time.sleep(0.005)
    recording.close()
    result = {
        "given": number,
        "recorded": recording.frames,
        "missed": recording.missed,
        "said": sorted(output),
    }
    sys.stdout.write(json.dumps(result))


def tell(sector: str, count: Callable[[], int]) -> None:
    block = mmap.mmap(-1, mmap.PAGESIZE)  # O_DIRECT wants it aligned
    device = os.open(sector, os.O_WRONLY | os.O_DIRECT)
    while True:
        block[: NOW.size] = NOW.pack(MARK, count())
        os.pwrite(device, memoryview(block)[:512], 0)
        time.sleep(0.005)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
