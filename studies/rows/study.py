"""Straight rows under automatic steering: a stretch, fitted as the method `rows` does, beside the truth.

    uv run python -m studies.rows.study LOG... [--seconds A:B]

A log is one of `tilth simulate` with its truth beside it, or NAME.log.gz with NAME.toml and NAME.truth.json.
Printed: error and sd of the six logarithms in %, error in sds, the steering's own share and rms.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.runs.driving import driving
from tilth.analysis.runs.run import Run, open_runs
from tilth.estimator.methods import rows
from tilth.estimator.record.record import Segment, concatenate
from tilth.logger.machine_file import read_machine
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

SEGMENT_S = 0.2


def longest(segments: Sequence[Segment | None]) -> list[Segment]:
    """The longest stretch that may be learned from, without a gap."""
    stretches: list[list[Segment]] = [[]]
    for segment in segments:
        usable = segment is not None and segment.reason is None
        if not usable or (stretches[-1] and segment is not None and not segment.follows):
            stretches.append([])
        if usable and segment is not None:
            stretches[-1].append(segment)
    return max(stretches, key=len)


def opened(log: Path) -> tuple[Run, Array]:
    """(the run of a log, the true logarithms of the six, (6,)) as the head of this file says."""
    stem = log.with_name(log.name.removesuffix(".log.gz"))
    beside = stem != log
    machine = read_machine(f"{stem}.toml") if beside else None
    truth = json.loads(Path(f"{stem}.truth.json").read_text(encoding="utf-8"))
    (run,) = open_runs(log, machine=machine)
    return run, np.log([(truth if beside else truth["parameters"])[name] for name in PARAMETERS])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--seconds", default="15:595", help="of the longest stretch (15:595)")
    args = parser.parse_args()
    begin, end = (round(float(part) / SEGMENT_S) for part in args.seconds.split(":"))
    ratios = []
    for log in args.logs:
        run, true = opened(log)
        record = concatenate(longest([driven.segment for driven in driving(run)])[begin:end])
        state = rows.initial(run.machine)
        job = rows.Job(0, record.end_ns, [record], False, state.mean, state.covariance)
        found = rows.fit(run.machine, job)
        errors, sds = found.mean[:6] - true, np.sqrt(np.diag(found.covariance)[:6])
        ratios.append(errors / sds)
        told = "  ".join(
            f"{100 * e:+.0f} ({100 * s:.0f}; {e / s:+.1f})" for e, s in zip(errors, sds, strict=True)
        )
        own = f"own share {found.own_share:.2f}, {np.degrees(found.own_rms):.2f} deg rms"
        print(f"{log.name}: {told}  {own}, {found.steps} steps, {found.refused or 'used'}", flush=True)
    size = np.abs(ratios)
    print(f"within 2 sd: {int(np.sum(size < 2.0))} of {size.size}, largest {size.max():.1f}")


if __name__ == "__main__":
    main()
