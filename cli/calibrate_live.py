"""`tilth calibrate --live`: beside a running daemon, tells a driver what to drive and what it has told."""

import argparse
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Final

import zenoh

from tilth.cli import WrongUse, as_given, say
from tilth.cli.calibrate_computing import BackgroundEstimates
from tilth.cli.calibrate_screen import KEYS, line, panel, without_seconds
from tilth.cli.daemon_order import client_config, daemon_of, no_daemon, of_key
from tilth.cli.live_screen import Screen
from tilth.client.calibration.shown import DRIVING, FINISHED, FINISHING, STOPPED, ParkedSenders, shown
from tilth.client.calibration.wires import COMPUTE, FINISH, CalibrationWires, calibrates_already
from tilth.client.link import ENDPOINT, living
from tilth.client.received import Refused, parse
from tilth.estimator.calibration import stages
from tilth.logger.machine_file import read_machine
from tilth.replay.growing import FollowedLogs, opening_machine
from tilth.replay.readers.log import LogError
from tilth.replay.readers.rig import bus_names, machine_in
from tilth.schemas.flow import Measurement
from tilth.schemas.invocation import command
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb

_say = partial(say, "calibrate")

TURN_S: Final = 0.5
READING_S: Final = 0.4  # longest time of a turn that goes into reading
RESCAN_S: Final = 2.0  # a daemon begins a new part, or gives a file another name
QUIET_S: Final = 5.0  # without a measurement
QUIT: Final = "quit"
STOPPED_TEXT: Final = "stopped; nothing was changed, and what was driven is in the logs"


def run_live(args: argparse.Namespace) -> int:
    """0 where what was driven has been computed and written as wanted, else 1."""
    if args.json:
        raise WrongUse("--json is for logs; --live shows what it finds here and on the page")
    machine = read_machine(args.machine).machine if args.machine is not None else None
    if missing := next((path for path in args.logs if not path.is_file()), None):
        raise WrongUse(f"{missing}: there is no such log")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    logs: FollowedLogs | None = None
    status = 1
    try:
        with ExitStack() as stack:
            wires = _wires(args, machine)
            stack.callback(wires.close)
            machine, logs = _logs(args, machine, wires)
            stack.callback(logs.close)
            live = LiveCalibration(wires, logs, machine, _estimates(args, stack))
            stack.callback(live.end)
            if _watch(live):
                status = _last_estimate(args, live, logs.paths)
            else:
                _say(STOPPED_TEXT)
    except KeyboardInterrupt:
        _say(STOPPED_TEXT)
    if status:
        _say_how_to_go_on(args, [] if logs is None else logs.paths)
    return status


def _last_estimate(args: argparse.Namespace, live: "LiveCalibration", logs: list[Path]) -> int:
    """The exit status. The wires are still open: the page is told how it ended."""
    live.estimates.close()
    from tilth.cli.calibrate_logs import run_logs  # the desk: only now

    status = run_logs(argparse.Namespace(**{**vars(args), "logs": logs}))
    live.phase = FINISHED
    return status


def _wires(args: argparse.Namespace, machine: Machine | None) -> CalibrationWires:
    """To the daemon that is meant. As a client: what a peer shows is not passed on to the page. Raises
    WrongUse."""
    name = machine.name if machine is not None else ""
    if args.config is not None:
        args.prefix, name = of_key(args.config)
    with ExitStack() as stack:
        try:
            session = stack.enter_context(zenoh.open(client_config(args.config, [args.connect])))
        except zenoh.ZError:
            raise no_daemon(args.config or args.connect, "See --connect and --config. ") from None
        if machine is not None:
            _check_name(args, session, machine)
        base = daemon_of(session, args.prefix, name, args.config).base(args.prefix)
        if calibrates_already(session, base):
            raise WrongUse(
                "a calibration of this machine is at work already, on the page too; end that one first"
            )
        found = _status(session, base)
        if found is not None and found.log_file and not Path(found.log_file).exists():
            raise WrongUse(
                f"{found.log_file}: the daemon writes this log, and it is not here; start this on the "
                "daemon's computer"
            )
        stack.pop_all()
    return CalibrationWires(session, base)


def _check_name(args: argparse.Namespace, session: zenoh.Session, machine: Machine) -> None:
    """Raises WrongUse where daemons run, but none of that machine."""
    known = "" if args.config is None else of_key(args.config)[1]
    names = [known] if known else [one.machine for one in living(session, args.prefix)]
    if names and machine.name not in names:
        raise WrongUse(f"{args.machine} is of {machine.name}; the daemon here is of {', '.join(names)}")


def _status(session: zenoh.Session, base: str) -> pb.Status | None:
    for reply in session.get(f"{base}/status", timeout=2.0):
        if reply.ok is not None:
            with suppress(Refused):
                return parse(pb.Status, reply.ok.payload.to_bytes(), str(reply.ok.encoding))
    return None


class LiveCalibration:
    """`turn` it twice a second."""

    def __init__(
        self, wires: CalibrationWires, logs: FollowedLogs, machine: Machine, estimates: BackgroundEstimates
    ) -> None:
        self.wires, self.estimates = wires, estimates
        self._logs, self._machine = logs, machine
        self.fold = stages.initial(machine)
        self._stream: Iterator[Measurement] | None = None
        self._rescan_s = self._measured_s = time.monotonic()
        self.phase = DRIVING
        self._senders = ParkedSenders(machine)

    def turn(self) -> pb.CalibrationState:
        """Take what has been written; say how it stands. Raises LogError, of logs of before."""
        now_s = time.monotonic()
        if now_s - self._rescan_s > RESCAN_S:
            self._rescan_s = now_s
            self._logs.rescan()
        for name in self.wires.logs:
            self._logs.writes(Path(name))
        behind = self._read(now_s + READING_S)
        if not behind:
            self.estimates.turn(self.fold, self._logs.paths)
        return self._show(self._trouble(now_s, behind))

    def end(self) -> None:
        """The last word, whatever ended it: the page keeps it for a while."""
        self.estimates.close()
        if self.phase != FINISHED:
            self.phase = STOPPED
        self._show("")

    def _show(self, trouble: str) -> pb.CalibrationState:
        notes = [*self._senders.lines(self.fold), *self._logs.notes]
        state = shown(self._machine.name, self.fold, self.estimates.so_far, notes, trouble, self.phase)
        self.wires.show(state)
        return state

    def _read(self, until_s: float) -> bool:
        """Whether there is more."""
        if self._stream is None:
            self._stream = self._logs.measurements()
        for count, measurement in enumerate(self._stream):
            stages.take(self.fold, measurement)
            self._measured_s = time.monotonic()
            if not count % 64 and self._measured_s > until_s:
                return True
        self._stream = None
        return False

    def _trouble(self, now_s: float, behind: bool) -> str:
        if behind:
            return "Reading what was driven so far …"
        quiet_s = now_s - self._measured_s
        if quiet_s > QUIET_S:
            return self.wires.trouble or (
                f"Nothing of the rig has been heard for {quiet_s:.0f} s: is the bus silent? The page's tiles "
                "show who is."
            )
        return ""


def _logs(
    args: argparse.Namespace, machine: Machine | None, wires: CalibrationWires
) -> tuple[Machine, FollowedLogs]:
    """Raises WrongUse."""
    begun = _first_log(wires)
    try:
        if machine is None:
            machine = machine_in([begun]).machine
        return machine, FollowedLogs(machine, args.logs, bus_names(args.bus, machine), begun)
    except LogError as error:
        raise WrongUse(str(error)) from None


def _estimates(args: argparse.Namespace, stack: ExitStack) -> BackgroundEstimates:
    found = BackgroundEstimates(as_given(args, "machine", "bus"))
    stack.callback(found.close)
    return found


def _watch(live: LiveCalibration) -> bool:
    """Whether the driver has finished. Raises WrongUse."""
    finished = False
    with Screen(panel, line, KEYS, without_seconds) as screen, suppress(KeyboardInterrupt):
        while True:
            began_s = time.monotonic()
            state = _turn(live)
            orders = [screen.show(state), *live.wires.orders()]
            if COMPUTE in orders:
                live.estimates.ask()
            if FINISH in orders or QUIT in orders:
                finished = FINISH in orders
                break
            time.sleep(max(TURN_S - (time.monotonic() - began_s), 0.0))
    if finished:
        live.phase = FINISHING
        _turn(live)
    return finished


def _turn(live: LiveCalibration) -> pb.CalibrationState:
    """Raises WrongUse."""
    try:
        return live.turn()
    except LogError as error:
        raise WrongUse(str(error)) from None


def _first_log(wires: CalibrationWires) -> Path:
    """The file that the daemon writes, once something is in it."""
    told = ""
    while True:
        path = Path(wires.logs[-1]) if wires.logs else None
        if path is not None and path.exists() and opening_machine(path) is not None:
            return path
        why = wires.trouble or "The daemon has not recorded anything yet."
        words = why.partition(" for ")[0]  # without the seconds
        if words != told:
            told = words
            _say(f"{why} Waiting; Ctrl-C ends it")
        time.sleep(TURN_S)


def _say_how_to_go_on(args: argparse.Namespace, logs: list[Path]) -> None:
    desk = as_given(args, "machine", "out", "report", "bus", "yes")
    options = desk + as_given(args, "config")
    if args.config is None:
        options += as_given(args, "connect") if args.connect != ENDPOINT else []
        options += as_given(args, "prefix") if args.prefix != "tilth" else []
    given = [str(path) for path in args.logs]
    _say(f"go on: {command('calibrate', *given, '--live', *options)}")
    if logs:
        _say(f"or compute with what there is: {command('calibrate', *map(str, logs), *desk)}")
