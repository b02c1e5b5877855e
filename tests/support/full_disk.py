"""A recording on a disk of 24 MB that fills and is emptied. Prints JSON.

full_disk.py FOLDER JOB: the folder is the disk (small_disk.py).
"""

import json
import sys
from pathlib import Path

from loopback import logged_frames, numbered
from one_recording import Recorder

from tilth.logger.log.recovery import finish
from tilth.logger.log.runs import Copied, Sidecar, StoredRun

LOG = "keep_free_megabytes = 1\nrotate_megabytes = 2"
MEGABYTE = 1_000_000


def fill(path: Path, size: int | None = None) -> None:
    """With so many bytes, or all there is."""
    with path.open("wb", buffering=0) as file:
        while size is None or file.tell() < size:
            try:
                file.write(b"x" * min(65536, (size or 1 << 40) - file.tell()))
            except OSError:
                return


def fails_and_resumes(folder: Path) -> dict[str, object]:
    run = Recorder(folder, log=LOG)
    frames = list(run.from_now(numbered(12_000)))
    for frame in frames[:2000]:
        run.take(frame)
    fill(folder / "filler")
    for frame in frames[2000:6000]:
        run.take(frame)
    run.until(lambda: "not recording" in run.recording.problem)
    output = run.recording.problem
    for frame in frames[6000:8000]:
        run.take(frame)
    still = run.recording.recording
    (folder / "filler").unlink()
    run.until(lambda: run.recording.problem == "")
    for frame in frames[8000:]:
        run.take(frame)
    run.recording.close()
    found = []
    for path in sorted(folder.glob("*.mcap")):
        finish(path)
        found += [int.from_bytes(frame.data, "little") for frame in logged_frames(path)]
    return {
        "said": output,
        "recording while full": still,
        "folded": run.fold.state.frames,
        "in the files": len(found),
        "first": found[:1600] == list(range(1600)),
        "last": found[-4000:] == list(range(8000, 12_000)),
        "recorded": run.recording.frames,
        "missed": run.recording.missed,
        "events": run.events,
    }


def makes_room(folder: Path) -> dict[str, object]:
    def stored(day: int, *, copied: bool = False, keep: bool = False) -> None:
        run = f"rig_202601{day:02d}T120000Z"
        path = folder / f"{run}_001.mcap"
        fill(path, 3 * MEGABYTE)
        copies = {path.name: Copied(3 * MEGABYTE, "", "stick")} if copied else {}
        StoredRun(folder, run, 0, (path,)).write_sidecar(Sidecar(keep, [], copies))

    stored(1)
    stored(2, copied=True, keep=True)
    stored(3, copied=True)
    stored(4, copied=True)
    run = Recorder(folder, log=LOG + '\nwhen_full = "delete_oldest"')
    run.until(lambda: run.recording.recording)
    run.recording.close()
    return {"left": sorted(path.name[4:12] for path in folder.glob("rig_*.mcap")), "events": run.events}


if __name__ == "__main__":
    top = Path(sys.argv[1])
    job = {"resumes": fails_and_resumes, "makes room": makes_room}[sys.argv[2]]
    sys.stdout.write(json.dumps(job(top)))
