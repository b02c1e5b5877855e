"""`tilth verify`: read logs fully, and say what is missing or wrong in them."""

import argparse
import json
from dataclasses import asdict, fields

from tilth.cli import WrongUse, log_path
from tilth.logger.clock import DATED_NS, utc_text
from tilth.replay.survey import Coverage, RunSurvey, survey
from tilth.schemas.flow import EventKind
from tilth.schemas.readable import reason_of

MOST_GAPS = 3
STEPPED = "clock_stepped"  # a fault that the steps themselves tell


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "verify",
        help="read logs completely, and report what is missing or damaged",
        description="Read Tilth's own logs completely and compare every checksum. Reports gaps of each bus "
        "and sensor, dropped frames, steps of the computer's clock, damage, missing parts. Give the "
        "files of a run in order.",
    )
    parser.add_argument("logs", nargs="+", type=log_path, metavar="LOG")
    parser.add_argument("--json", action="store_true", help="for programs")


def run(args: argparse.Namespace) -> int:
    """1 where something is damaged, missing or was dropped; a silent sensor is said, no more."""
    try:
        found = survey(args.logs)
    except OSError as error:
        raise WrongUse(f"{error.filename}: {reason_of(error)}; give the files of a run") from None
    if args.json:
        print(json.dumps([_plain(one) for one in found], indent=1))
    else:
        print("\n\n".join("\n".join(_lines(one)) for one in found))
    return 0 if all(one.good for one in found) else 1


def _lines(one: RunSurvey) -> list[str]:
    size = sum(path.stat().st_size for path in one.files) / 1e6
    name = one.files[0].name.rpartition("_")[0] or one.files[0].name
    if not one.run:
        return one.wrong or [f"{one.files[0].name}: is being written; nothing is in it yet"]
    files = _many(len(one.files), "file")
    lines = [f"{name}: {files}, {size:.1f} MB, {one.duration_s:.1f} s from {_utc(one, one.first_ns)}"]
    lines += [f"  note: {one.note}"] * bool(one.note)
    lines += [f"  {_name(topic):<18} {_words(one, coverage)}" for topic, coverage in one.coverage.items()]
    lines += [f"  {fault}: {count}" for fault, count in one.faults.items() if fault.reason != STEPPED]
    lines += [f"  the log's time runs back {one.backwards} times"] * bool(one.backwards)
    lines += [
        f"  the computer's clock was set by {s:+.3f} s; the log's own went on evenly" for s in one.steps_s
    ]
    lines.append(f"  UTC {_utc_source(one)}")
    lines += [f"  {_utc(one, e.t_ns)} mark: {e.text}" for e in one.events if e.kind == EventKind.MARK]
    lines += [f"  WRONG: {what}" for what in one.wrong]
    lines += [f"  goes on in {one.goes_on_in}, which was not read"] * bool(one.goes_on_in)
    lines += ["  being written: read as far as it was on the disk"] * one.being_written
    lines.append("  whole, nothing dropped" if one.good else "  NOT ALL IS THERE")
    return lines


def _utc_source(one: RunSurvey) -> str:
    confirmed = "confirmed by GNSS" if one.by_gnss else "not confirmed by any receiver"
    if one.first_ns < DATED_NS:
        known = one.first_ns + one.utc_minus_ns >= DATED_NS
        return (
            f"{confirmed}; the computer began with a wrong clock"
            if known
            else "not known: the clock is wrong"
        )
    moved = f", {one.utc_minus_ns * 1e-9:+.0f} s from what the computer believed" if one.utc_minus_ns else ""
    return confirmed + moved


def _words(one: RunSurvey, coverage: Coverage) -> str:
    if not coverage.count:
        return "never heard"
    text = f"{coverage.count:>9} at {coverage.per_s:.1f}/s, "
    if not coverage.gaps:
        return text + "no gap"
    gaps = ", ".join(f"{length:.1f} s at {_utc(one, t_ns)}" for t_ns, length in coverage.gaps[:MOST_GAPS])
    more = f" and {len(coverage.gaps) - MOST_GAPS} more" if len(coverage.gaps) > MOST_GAPS else ""
    return f"{text}{_many(len(coverage.gaps), 'gap')}: {gaps}{more}"


def _many(count: int, thing: str) -> str:
    return f"{count} {thing}{'s' * (count != 1)}"


def _name(topic: str) -> str:
    return topic.rpartition("/")[2].replace("_", " ")


def _utc(one: RunSurvey, t_ns: int) -> str:
    return utc_text(t_ns + one.utc_minus_ns)


def _plain(one: RunSurvey) -> dict[str, object]:
    """Keys are those of docs/logs.md: the coverage of each topic stands under `heard`."""
    published = {"coverage": "heard"}
    plain: dict[str, object] = {
        published.get(each.name, each.name): getattr(one, each.name) for each in fields(one)
    }
    plain["files"] = [str(path) for path in one.files]
    plain["heard"] = {topic: _coverage_json(coverage) for topic, coverage in one.coverage.items()}
    plain["faults"] = {str(fault): count for fault, count in one.faults.items()}
    plain["events"] = [
        {"t_ns": e.t_ns, "utc": _utc(one, e.t_ns), "kind": e.kind, "text": e.text} for e in one.events
    ]
    began = _utc(one, one.first_ns) if one.first_ns else ""
    return plain | {"began": began, "duration_s": one.duration_s, "good": one.good}


def _coverage_json(coverage: Coverage) -> dict[str, object]:
    """`gaps`: [t_ns, s] of each."""
    return {**asdict(coverage), "longest_gap_s": max((length for _, length in coverage.gaps), default=0.0)}
