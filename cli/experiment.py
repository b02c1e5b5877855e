"""`tilth experiment`: proposes a plan of experiments, and prompts a driver through one."""

import argparse
import re
import signal
import sys
import time
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import zenoh
from numpy.random import default_rng

from tilth.cli import WrongUse, as_given, duration, say
from tilth.cli.daemon_order import client_config, no_daemon, of_key
from tilth.cli.experiment_learned import EDITED, FitOfRuns
from tilth.cli.experiment_screen import KEYS, line, panel
from tilth.cli.live_screen import Screen
from tilth.client.experiment.prompter import Course, Prompt, course_of, skipped_of
from tilth.client.experiment.runner import TURN_S, PlanRunner
from tilth.client.experiment.sight import FieldCorner, corner_of
from tilth.client.experiment.wires import PrompterWires, prompts_already
from tilth.client.link import ENDPOINT, living
from tilth.client.received import Refused
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.estimator.models.planned_run import Scheduled, share_followed
from tilth.logger.machine_file import read_machine
from tilth.schemas.experiment import KINDS, ExperimentPlan, PlanError, Rectangle, edited, parse_plan
from tilth.schemas.invocation import command
from tilth.schemas.readable import reason_of

_say = partial(say, "experiment")

FIELD = re.compile(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)")
MOST_TRIES = 999
CUT = 0.75  # of the steering: a run of which less can be followed is told of
_PROMPTS = "a driver is prompted through {} already, and two would mark one log; end that one first"
_NOT_PROPOSING = "--from and --out are for --propose"
_OF_A_PROPOSAL: dict[str, object] = {
    "speed": 4.5, "seconds": 20.0, "replicates": 3, "runs": 3, "kind": [], "seed": 1,
    "field": Rectangle(length=400, width=80, headland=0), "headland": None, "angle": None,
}  # fmt: skip
"""Options of --propose alone and what they are by default; headlands come with --headland."""


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "experiment",
        help="propose a plan of experiments, or prompt a driver through one",
        description="With PLAN.toml, beside a running daemon: prompts a driver through the plan, here and "
        "on the page, and marks the log. It never steers, and starts nothing by itself. With "
        "--propose: writes the plan whose runs reveal most of what is not known yet.",
    )
    parser.add_argument("plan", nargs="?", type=Path, metavar="PLAN.toml", help="the plan to drive")
    parser.add_argument("--connect", default=ENDPOINT, metavar="ENDPOINT", help=f"the daemon ({ENDPOINT})")
    parser.add_argument("--config", type=Path, metavar="KEY.json", help="an operator's key from `tilth keys`")
    parser.add_argument(
        "--prefix", default="tilth", metavar="P", help="prefix in [zenoh] of the machine file (tilth)"
    )
    parser.add_argument(
        "--start-at", type=int, default=1, metavar="N", help="continue with run N of the order, after a quit"
    )
    parser.add_argument(
        "--try", dest="tries", type=int, default=1, metavar="K", help="number of the next try of that run (1)"
    )
    parser.add_argument(
        "--corner", type=_corner, metavar="LAT,LON,HEADING",
        help="where the field is, in degrees; write --corner=… as printed by a prompter that was quit",
    )  # fmt: skip
    parser.add_argument(
        "--check", action="store_true",
        help="only check whether the plan fits the rig of --machine and its field, without a daemon",
    )  # fmt: skip
    new = parser.add_argument_group("a new plan")
    new.add_argument("--propose", action="store_true", help="write a plan instead")
    new.add_argument(
        "--machine", type=Path, metavar="M.toml", help="machine file of the rig that will drive it"
    )
    new.add_argument(
        "--from", dest="logs", nargs="+", type=Path, default=[], metavar="LOG", help="earlier drives"
    )
    new.add_argument("--out", type=Path, metavar="PLAN.toml", help="write the plan to this file")
    new.add_argument("--speed", type=duration, metavar="M/S", help="speed of all runs (4.5)")
    new.add_argument("--seconds", type=duration, metavar="S", help="longest run, 8 to 60 (20)")
    new.add_argument("--replicates", type=int, metavar="N", help="replicates of each run (3)")
    new.add_argument("--runs", type=int, metavar="N", help="number of kinds (3)")
    new.add_argument("--kind", action="append", choices=KINDS, help="only this kind; may be repeated")
    new.add_argument("--seed", type=int, metavar="N", help="seed of the order (1)")
    new.add_argument(
        "--field", type=_field, metavar="LxW",
        help="length and width of the field in m (400x80)",
    )  # fmt: skip
    new.add_argument("--headland", type=float, metavar="M", help="headland at both ends (20)")
    new.add_argument("--angle", type=duration, metavar="DEG", help="limit of the wheels (12)")
    parser.set_defaults(**_OF_A_PROPOSAL)


def _field(text: str) -> Rectangle:
    found = FIELD.fullmatch(text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text}: write LENGTHxWIDTH in m, such as 400x80")
    try:
        return Rectangle(length=float(found[1]), width=float(found[2]), headland=0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: a field is 30 to 5000 m long, 10 to 5000 m wide") from None


def _corner(text: str) -> FieldCorner:
    try:
        numbers = FieldCorner(*map(float, text.split(",")))
        Rectangle(length=30, width=10, headland=0, **_of_field(numbers))
    except (TypeError, ValueError):
        raise argparse.ArgumentTypeError(
            f"{text}: write LATITUDE,LONGITUDE,HEADING in degrees, such as --corner=43.4995000,-83.4005000,90"
        ) from None
    return numbers


def _of_field(corner: FieldCorner) -> dict[str, Any]:
    """Keys of a plan's [field]."""
    return {"corner": (corner.latitude, corner.longitude), "heading_deg": corner.heading_deg}


def run(args: argparse.Namespace) -> int:
    """1 where not all runs were driven, or a proposal is of no use; 2 where it cannot begin."""
    resumes = args.start_at != 1 or args.tries != 1 or args.corner is not None
    if args.propose:
        _refuse(
            (resumes, "--start-at, --try and --corner go with a plan to drive, not with --propose"),
            (args.plan is not None, "--propose writes a plan to --out; leave out the one to drive"),
            (args.check, "--check goes with a plan that is there, not with --propose"),
        )
        from tilth.cli.experiment_propose import propose  # with the fits: only who asks pays for it

        return propose(args)
    if args.check:
        return _check(args, resumes)
    own_file = "--machine is for --propose and --check; to drive, the machine file is that of the daemon"
    new = "give the plan to drive, or --propose --machine M.toml --out PLAN.toml for a new one"
    _refuse((args.plan is None, new), (args.machine, own_file), (args.logs or args.out, _NOT_PROPOSING))
    _refuse_proposing(args)
    return _drive_plan(args, _read(args.plan))


def _drive_plan(args: argparse.Namespace, plan: ExperimentPlan) -> int:
    count = sum(one.replicates for one in plan.run)
    _refuse(
        (not 1 <= args.start_at <= count, f"--start-at {args.start_at}: {args.plan} has runs 1 to {count}"),
        (
            not 1 <= args.tries <= MOST_TRIES,
            f"--try {args.tries}: give a whole number from 1 to {MOST_TRIES}",
        ),
    )
    if args.corner is not None:
        field = plan.field.model_copy(update=_of_field(args.corner))
        plan = plan.model_copy(update={"field": field})
    with ExitStack() as stack:
        try:
            wires = _wires(args, plan)
        except zenoh.ZError:
            raise _nobody(args) from None
        stack.callback(wires.close)
        course = _course(args, plan, wires)
        return _drive(args, course, wires)


def _refuse(*cases: tuple[object, str]) -> None:
    """Raises WrongUse with the words of the first case that is so."""
    for is_so, words in cases:
        if is_so:
            raise WrongUse(words)


def _refuse_proposing(args: argparse.Namespace) -> None:
    """Raises WrongUse where an option of --propose stands beside a plan."""
    if given := [f"--{name}" for name, default in _OF_A_PROPOSAL.items() if getattr(args, name) != default]:
        raise WrongUse(f"{', '.join(given)}: for --propose; what is driven stands in {args.plan}")


def _check(args: argparse.Namespace, resumes: bool) -> int:
    """Prints that a plan can be driven. Raises WrongUse where it cannot."""
    driving = "--start-at, --try, --corner and --connect go with a plan to drive, not with --check"
    _refuse(
        (args.plan is None, "--check needs the plan to look at"),
        (args.machine is None, "--check needs --machine M.toml"),
        (args.logs or args.out, _NOT_PROPOSING),
        (resumes or args.connect != ENDPOINT, driving),
    )
    _refuse_proposing(args)
    plan, (machine, _) = _read(args.plan), read_machine(args.machine)
    if plan.machine != machine.name:
        raise WrongUse(f'{args.plan} is for machine = "{plan.machine}"; {args.machine} is of {machine.name}')
    drives = _fitting(args, plan, rig_of(machine)).drives
    runs = "1 run" if len(drives) == 1 else f"{len(drives)} runs"
    seconds = sum(one.seconds for one in drives)
    print(f"{args.plan}: {runs}, {seconds:.0f} s between their marks, fit the rig and the field.")
    if plan.predicted_for and not edited(plan):  # of a proposal, which was chosen with these limits in force
        return 0
    for text in dict.fromkeys(_cut(plan, one.scheduled) for one in drives):
        if text:
            print(text)
    if edited(plan):
        print(EDITED)
    return 0


def _cut(plan: ExperimentPlan, one: Scheduled) -> str:
    """What the limit of the wheel's rate takes from a run, in a sentence; "" where it is little."""
    left = share_followed(one, plan.limits, default_rng((plan.seed, *one.key)))
    if left > CUT:
        return ""
    return (
        f"run[{one.number}], {one.run.kind}: limits.wheel_rate_degps = {plan.limits.wheel_rate_degps:g} "
        f"leaves {left:.0%} of the steering; take a smaller angle, or steer more slowly"
    )


def _fitting(args: argparse.Namespace, plan: ExperimentPlan, rig: Rig) -> Course:
    """Raises WrongUse where a run is too hard or has no room."""
    try:
        return course_of(plan, rig)
    except PlanError as error:
        raise WrongUse(f"{args.plan}: {error}") from None


def _read(path: Path) -> ExperimentPlan:
    try:
        return parse_plan(path.read_text(encoding="utf-8-sig"))
    except PlanError as error:
        raise WrongUse(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise WrongUse(f"{path}: no plan: not UTF-8 text") from None
    except OSError as error:
        raise WrongUse(f"{path}: the plan cannot be read ({reason_of(error)})") from None


def _wires(args: argparse.Namespace, plan: ExperimentPlan) -> PrompterWires:
    """Raises WrongUse, ZError."""
    if args.config is not None:
        args.prefix, _ = of_key(args.config, "mark")
    try:
        session = zenoh.open(client_config(args.config, [args.connect]))
    except zenoh.ZError:
        raise _nobody(args) from None
    alive = living(session, args.prefix, plan.machine)
    meant = next((one for one in alive if one.machine == plan.machine), None)
    if meant is None:
        others = ", ".join(one.machine for one in living(session, args.prefix)) if not args.config else ""
        session.close()
        if others:
            raise WrongUse(f'{args.plan} is for machine = "{plan.machine}"; the daemon here is of {others}')
        raise _nobody_on(args, plan)
    if other := prompts_already(session, meant.base(args.prefix)):
        session.close()
        raise WrongUse(_PROMPTS.format(other))
    return PrompterWires(session, meant.base(args.prefix))


def _nobody(args: argparse.Namespace) -> WrongUse:
    return no_daemon(args.config or args.connect, "See --connect and --config. ")


def _nobody_on(args: argparse.Namespace, plan: ExperimentPlan) -> WrongUse:
    """Something answers there, but not for this machine."""
    if args.config is not None:
        return _nobody(args)
    return WrongUse(
        f"no daemon is heard on {args.prefix}/{plan.machine} at {args.connect}; is `{command('run')}` "
        "running? --prefix is that of [zenoh] in its machine file"
    )


def _course(args: argparse.Namespace, plan: ExperimentPlan, wires: PrompterWires) -> Course:
    """Checks that the plan fits the rig, and that this may mark. Raises WrongUse."""
    try:
        course = _fitting(args, plan, wires.rig().rig)
    except Refused as error:
        raise WrongUse(str(error)) from None
    count = len(course.drives)
    words = "1 run is planned" if count == 1 else f"{count} runs are planned"
    if args.start_at > 1 or args.tries > 1:
        words = f"goes on with run {args.start_at} of {count}"
    answer = wires.mark_now(f"experiment {plan.name} seed {plan.seed}: {words}")
    if answer.refusal:
        raise WrongUse(f"no mark can be put into the log: {answer.refusal}")
    return course


def _drive(args: argparse.Namespace, course: Course, wires: PrompterWires) -> int:
    """Until all is driven and it has been seen, or until Ctrl-C."""
    for ending in (signal.SIGTERM, signal.SIGHUP):  # also a terminal that is closed
        signal.signal(ending, signal.default_int_handler)
    runner = PlanRunner(wires, course, at=args.start_at - 1, tries=args.tries)
    learning: FitOfRuns | None = None
    with Screen(panel, line, KEYS) as screen:
        with suppress(KeyboardInterrupt):
            while not wires.gives_way_to:
                began_s = time.monotonic()
                state = runner.turn()
                pressed = screen.show(state)
                if pressed == "quit":
                    break
                if pressed:
                    runner.order(pressed)
                if runner.finished and learning is None:
                    learning = FitOfRuns(course.plan, wires.logs)
                if learning is not None:
                    runner.learned, runner.commands = learning.told()
                    if learning.over and not screen.asks:
                        screen.show(runner.turn())
                        break
                time.sleep(max(TURN_S - (time.monotonic() - began_s), 0.0))
        with suppress(KeyboardInterrupt):  # who is in a hurry presses it again
            runner.leave()
    if learning is not None:
        learning.close()
    if wires.gives_way_to:
        raise WrongUse(_PROMPTS.format(wires.gives_way_to))
    return _ended(args, course, runner.prompt)


def _ended(args: argparse.Namespace, course: Course, prompt: Prompt) -> int:
    """Exit status; what was left out is said, and how to go on."""
    count = len(course.drives)
    skipped = skipped_of(prompt.attempts, count)
    if skipped:
        _say(skipped)
    left = count - prompt.at
    if left:
        were = "was" if left == 1 else "were"
        _say(f"{left} of {count} runs {were} not driven")
        print(f"to go on: {_going_on(args, course, prompt)}", file=sys.stderr)
    return 1 if left or skipped else 0


def _going_on(args: argparse.Namespace, course: Course, prompt: Prompt) -> str:
    """The command that goes on where this one was, with its options, in the same field."""
    words = as_given(args, "connect") if args.connect != ENDPOINT else []
    words += as_given(args, "config")
    words += as_given(args, "prefix") if args.prefix != "tilth" and not args.config else []
    words += ["--start-at", str(prompt.at + 1)]
    words += [] if prompt.tries == 1 else ["--try", str(prompt.tries)]
    if args.corner is not None:
        words.append(f"--corner={args.corner.text}")
    elif course.plan.field.corner is None and prompt.place is not None:
        words.append(f"--corner={corner_of(prompt.place).text}")
    return command("experiment", str(args.plan), *words)
