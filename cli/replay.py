"""`tilth replay`: logs through the same fold as live, as fast as it goes or at a given rate."""

import argparse
import json
import math
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path

import zenoh
from rich.console import Console
from rich.table import Table

from tilth.analysis.report.wording import SAYS
from tilth.analysis.runs.nuisance_words import WORDS, nuisance_text
from tilth.cli import WrongUse, add_bus_names, buses_of, log_path, say, say_unusual
from tilth.cli.log_errors import log_errors
from tilth.cli.progress_bar import bars
from tilth.cli.unread import who
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.logger.log.whole_file import whole
from tilth.logger.machine_file import read_machine
from tilth.logger.zenoh.session import why
from tilth.logger.zenoh.sink import SIMULATED_SUFFIX, ZenohSink
from tilth.replay.compare import Comparison
from tilth.replay.estimates_json import estimates_and_nuisances
from tilth.replay.offline import Pace, ReplayOutputs, ReplaySummary, replay
from tilth.replay.readers.any_log import MCAP, open_log
from tilth.replay.readers.log import EmptyLog, LogError
from tilth.replay.readers.rig import machine_in
from tilth.replay.simulated import REPLAY, SAID, simulated_by
from tilth.schemas.device_names import device
from tilth.schemas.flow import PARAMETERS, Estimate, Frame, Origin
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_difference import differing
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable, reason_of
from tilth.schemas.rejections import Rejection
from tilth.schemas.sentences import event_sentence, rejection_sentence, sentence
from tilth.schemas.spread import of_parameter

_say = partial(say, "replay")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("replay", help="feed logs through the estimators again")
    parser.add_argument("logs", nargs="+", type=log_path, metavar="LOG", help="read in the order given")
    parser.add_argument(
        "--machine", type=Path, metavar="M.toml",
        help="machine file, instead of the one in the log; required if tilth did not write the log",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="OUT.mcap", help="write frames and results to a new log")
    parser.add_argument("--publish", action="store_true", help="publish on Zenoh, under the replay prefix")
    parser.add_argument(
        "--rate", type=_rate, default=None, metavar="1|max|N", help="speed, as a multiple of real time (max)"
    )
    parser.add_argument(
        "--verify", action="store_true", help="compare with the results that were logged live"
    )
    add_bus_names(parser)
    parser.add_argument("--json", action="store_true", help="the summary as one JSON object")


def _rate(text: str) -> float | None:
    """Times real time; None: as fast as it goes."""
    if text == "max":
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0.0 < rate < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: give 1 for real time, another factor above zero, or max")
    return rate


def run(args: argparse.Namespace) -> int:
    comparison = Comparison() if args.verify else None
    with log_errors(args.out):
        _check_logs(args)
        machine_file = read_machine(args.machine) if args.machine else machine_in(args.logs)
        machine = machine_file.machine
        say_unusual("replay", machine)
        _say_other_files(args, machine)
        buses = buses_of(args, machine)
        with ExitStack() as stack:
            outputs = _outputs(stack, args, machine_file, comparison)
            simulated = simulated_by(args.logs)
            if simulated:
                _say(SAID)
            summary = replay(args.logs, machine_file, buses=buses, outputs=outputs, say=_say)
    if args.json:
        print(json.dumps({**_as_json(summary, comparison), "simulated": bool(simulated)}))
    else:
        _show(summary, comparison)
    unlike = comparison is not None and (comparison.difference or comparison.unverifiable)
    return 1 if summary.faults or unlike else 0


def _say_other_files(args: argparse.Namespace, machine: Machine) -> None:
    """Where a log holds another machine file than the one that is used. Raises LogError, MachineError."""
    for path in args.logs if args.machine is None else ():
        with suppress(LogError, MachineError):  # those without any take this one, which is said elsewhere
            own = machine_in([path]).machine
            if own != machine:
                _say(
                    f"{path}: its machine file differs in {differing(machine, own)}; that of {args.logs[0]} "
                    "is used for all logs: replay them one by one, or give --machine"
                )


def _check_logs(args: argparse.Namespace) -> None:
    """Find out before a long replay that a file is none. Raises LogError, WrongUse."""
    for path in args.logs:
        try:
            log = open_log(path)
        except EmptyLog:
            if len(args.logs) == 1:
                raise
            continue
        log.file.close()
        if args.verify and log.form != MCAP:
            raise WrongUse(
                f"{path}: --verify needs the results of a live run; only tilth's own logs hold them"
            )


def _outputs(
    stack: ExitStack, args: argparse.Namespace, machine_file: MachineFile, comparison: Comparison | None
) -> ReplayOutputs:
    """Open what the results go to; the stack closes it."""
    writer = publish = None
    if args.out is not None:
        writer = _writer(stack, args, machine_file)
        stack.callback(_close, writer, args.out)
    if args.publish:
        sink = _zenoh(machine_file.machine)
        stack.callback(sink.close)
        publish = sink.put
    steps, size = bars(stack), sum(path.stat().st_size for path in args.logs)
    pace = None if args.rate is None else Pace(args.rate)
    return ReplayOutputs(writer, publish, comparison, pace, lambda done: steps("replay", done, size))


def _writer(stack: ExitStack, args: argparse.Namespace, machine_file: MachineFile) -> LogWriter:
    run = RunPart(REPLAY, 1, _first_ns(args.logs), simulated=simulated_by(args.logs))
    try:
        part = stack.enter_context(whole(args.out))
        writer = LogWriter(part, machine_file, run)
    except FileExistsError:
        raise WrongUse(f"{args.out}: exists; a log is never overwritten, give another name") from None
    except OSError as error:
        raise WrongUse(f"--out {args.out}: {reason_of(error)}") from None
    writer.metadata(REPLAY, {"logs": "\n".join(readable(path.resolve()) for path in args.logs)})
    return writer


def _close(writer: LogWriter, out: Path) -> None:
    """A log without a frame is of no use and would stand in the way of the next try."""
    writer.close()
    if not writer.frames:
        writer.path.unlink()
        _say(f"{out}: not written, there was no frame")


def _first_ns(logs: Sequence[Path]) -> int:
    """t_ns of the first frame; 0 where there is none."""
    for path in logs:
        try:
            log = open_log(path)
            with log.file:
                return next((record.t_ns for record in log.records if isinstance(record, Frame)), 0)
        except EmptyLog:
            continue
    return 0


def _zenoh(machine: Machine) -> ZenohSink:
    try:
        sink = ZenohSink(machine, SIMULATED_SUFFIX)
    except zenoh.ZError as error:
        raise WrongUse(f"Zenoh cannot be started ({why(error)}); check [zenoh] in the machine file") from None
    _say(f"publishing under {sink.base}" + (f"; {sink.note}" if sink.note else ""))
    return sink


def _as_json(summary: ReplaySummary, comparison: Comparison | None) -> dict[str, object]:
    answer: dict[str, object] = {
        "frames": summary.frames,
        "measurements": summary.measurements,
        "rejected": summary.rejected,
        "poses": summary.poses,
        "duration_s": summary.duration_ns * 1e-9,
        "truncated": summary.truncated,
        "unknown_sources": [_sender(origin, number) for origin, number in summary.unknown.items()],
        "left_out": summary.left_out,
        "events": [{**asdict(event), "text": event_sentence(event)} for event in summary.events],
        "flags": {flag: asdict(flagged) for flag, flagged in sorted(summary.flags.items())},
        **estimates_and_nuisances(summary.estimates),
    }
    if comparison is not None:
        answer["verify"] = {
            "compared": comparison.compared,
            "difference": comparison.difference or None,
            "unverifiable": comparison.unverifiable,
            "to_the_byte": comparison.to_the_byte,
            "ties": comparison.ties,
            "turned": comparison.turned,
            "recorded_elsewhere": comparison.elsewhere or None,
            "largest": None if comparison.largest is None else comparison.largest._asdict(),
        }
    return answer


def _sender(origin: Origin, messages: int) -> dict[str, object]:
    """One whose messages were not used since it is no receiver of the machine file."""
    name = origin.name
    return {
        "bus": origin.bus,
        "source": origin.source,
        "name": None if name is None else f"{name:016X}",
        "device": None if name is None else device(name),
        "messages": messages,
    }


def _show(summary: ReplaySummary, comparison: Comparison | None) -> None:
    console = Console()
    recommended = summary.estimates.get("recommended")
    for method, estimate in summary.estimates.items():
        if estimate is not recommended:
            console.print(_table(method, estimate))
    cut = ", cut off" if summary.truncated else ""
    console.print(
        f"{summary.frames} frames in {summary.duration_ns * 1e-9:.1f} s{cut}; "
        f"{summary.measurements} measurements, {summary.poses} poses"
    )
    for reason, count in sorted(summary.rejected.items()):
        console.print(f"rejected: {count} {rejection_sentence(reason)}")
        for origin, messages in summary.unknown.items() if reason == Rejection.UNKNOWN_SOURCE else ():
            console.print(f"    {messages} of {who(origin)}")
        for text in summary.left_out if reason == Rejection.OTHER_TIME else ():
            console.print(f"    {text}")
    for flag, flagged in sorted(summary.flags.items()):
        console.print(f"flagged: {flagged.poses} poses {flag}")
    if not summary.poses:
        console.print("No estimate: there were too few poses; see what is rejected, and the machine file.")
    if recommended is not None:
        console.print(_recommended(recommended))
    if comparison is not None:
        console.print(_compared(comparison))


def _compared(comparison: Comparison) -> str:
    if comparison.difference:
        return f"Differs: {comparison.difference}"
    found = f"{comparison.compared} results are those that were logged live, to the byte."
    if comparison.elsewhere:
        found = (
            f"{comparison.compared} results are equal within their tolerances, {comparison.to_the_byte} of "
            f"them to the byte{_largest(comparison)}; no decision differs{_ties(comparison)}. They were "
            f"recorded elsewhere: {comparison.elsewhere}."
        )
    if not comparison.unverifiable:
        return f"All {found}"
    damaged = f"{comparison.unverifiable} behind what is damaged, up to the next stored state."
    return f"{found} Not verifiable: {damaged}"


def _ties(comparison: Comparison) -> str:
    told = ""
    if comparison.ties:
        what = "1 fit ends" if comparison.ties == 1 else f"{comparison.ties} fits end"
        told = f"; {what} elsewhere here, as near the maximum, and the logged result was used"
    if comparison.turned:
        what = "1 decision is" if comparison.turned == 1 else f"{comparison.turned} decisions are"
        told += f"; {what} as logged that rounding would turn here"
    return told


def _largest(comparison: Comparison) -> str:
    largest = comparison.largest
    if largest is None:
        return ""
    return f", the largest difference {largest.amount:.0e} of {largest.tolerance:.0e} in {largest.field}"


def _recommended(estimate: Estimate) -> Table:
    """What to use, last of all: the six alone, and whose they are."""
    table = _of_six("recommended")
    _add_six(table, estimate)
    rule = f": {sentence(estimate.rule)}" if estimate.rule else ""
    table.caption = f"by {estimate.method}{rule}"
    table.caption_justify = "left"
    return table


def _of_six(title: str) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("", "estimate", "status", "reason"):
        table.add_column(heading, overflow="fold")
    return table


def _add_six(table: Table, estimate: Estimate) -> None:
    for name, p in zip(PARAMETERS, estimate.parameters, strict=True):
        value_text = "-" if p.value is None or p.sd is None else of_parameter(name, p.value, p.sd)
        table.add_row(name, value_text, p.status.name.lower(), sentence(p.reason))


def _table(title: str, estimate: Estimate) -> Table:
    table = _of_six(title)
    _add_six(table, estimate)
    if (own := estimate.own_steering) is not None:
        told = f"{100 * own.share:.0f} % of it, {math.degrees(own.rms):.2f}° rms"
        table.add_row("wheel angle in rows that is the steering's own", told, "measured", "")
    if (at := estimate.of_place) is not None:
        shares = (
            ("this pass", at.this_pass),
            ("passes before", at.neighbours),
            ("the machine file", at.prior),
        )
        told = ", ".join(f"{words} {100 * share:.0f} %" for words, share in shares)
        table.add_row("where the rig is, by", told, f"soil is alike over {at.radius_m:.0f} m", "")
    for name, (value, sd) in estimate.nuisances.items():
        table.add_row(f"{WORDS[name].words} ({name})", nuisance_text(name, value, sd) + SAYS, "nuisance", "")
    return table
