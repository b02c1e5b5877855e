"""The controller as a process: hears a daemon over Zenoh, commands the steering by CAN.

    python -m tilth.adaptive_guidance --machine jd7930-parker500 --interface socketcan --channel can0 \\
        --origin 42.0267 -93.6465 --rows 8 --length 120 --spacing 54 --radius 20

Rows run to and fro, the first one north from the origin. Once a second it says a line of JSON: whether it
steers and why not, where it is, and how far the parameters in force are from nominal. Ctrl-C ends it; it
lets go of the steering first.
"""

import argparse
import json
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import can

from tilth.adaptive_guidance.controller import LIMITS, Controller
from tilth.adaptive_guidance.follower import PERIOD_S
from tilth.adaptive_guidance.plan import Work, plan
from tilth.adaptive_guidance.wires import Wires
from tilth.client import InForce
from tilth.client.link import ENDPOINT

TELL_S: Final = 1.0
EARLY_S: Final = 0.05  # a pose of later than now is of another clock


@dataclass(slots=True)
class ControlLoop:
    """The loop, one call for each period."""

    wires: Wires
    controller: Controller
    adapting: bool
    another_clock: int = 0  # poses whose instant is still to come
    force: InForce | None = None

    def turn(self) -> None:
        now = self.wires.now()
        for pose in self.wires.poses():
            at = pose.t_ns * 1e-9
            if at > now + EARLY_S:
                self.another_clock += 1
            else:
                self.controller.pose(pose, at)
        if self.adapting:
            self.wires.place = self.controller.ahead()
            self.force = self.controller.estimate(self.wires.latest(), now, self.wires.ahead())
        self.wires.send(self.controller.command(self.wires.now()))

    def report(self) -> dict[str, object]:
        """What a person wants to know."""
        follower, latest = self.controller.follower, self.wires.latest()
        at = min(round(follower.station), len(follower.plan.row) - 1)
        ratios = follower.theta / follower.rig.theta
        notes = () if self.force is None else self.force.notes
        return {
            "steers": not self.controller.code,
            "code": self.controller.code,
            "reason": self.controller.reason,
            "row": int(follower.plan.row[at]),
            "done": follower.done,
            "over_nominal": [round(ratio, 3) for ratio in ratios.tolist()],
            "notes": sorted(set(filter(None, notes))),
            "estimate_age_s": None if latest.estimate is None else round(latest.age_s, 1),
            "poses_unusable": self.controller.unusable,
            "poses_of_another_clock": self.another_clock,
            "refused": self.wires.refused,
        }


def run(
    wires: Wires, options: argparse.Namespace, open_bus: Callable[[], can.BusABC], stop: Callable[[], bool]
) -> int:
    """Until the plan is done or `stop`. The bus hears of it once it is ready to steer."""
    _say({"code": "no_daemon", "reason": "no daemon has been heard yet"})
    while (rig := wires.rig) is None:
        if stop():
            return 1
        wires.wait(PERIOD_S)
    work = Work(options.rows, options.length, options.spacing, options.radius)
    controller = Controller(plan(work, rig.rig), rig.rig, (options.origin[0], options.origin[1]), LIMITS)
    wires.command_on(open_bus())
    turns = ControlLoop(wires, controller, options.gains == "adapting")
    next_turn = next_word = time.monotonic()
    while not (stop() or controller.follower.done):
        turns.turn()
        if time.monotonic() >= next_word:
            next_word += TELL_S
            _say(turns.report())
        next_turn = max(next_turn + PERIOD_S, time.monotonic())
        time.sleep(max(next_turn - time.monotonic(), 0.0))  # its pace, and the steering's
    wires.send(controller.release())
    _say(turns.report())
    return 0


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tilth.adaptive_guidance", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--machine", required=True, help="its name in the machine file")
    parser.add_argument("--connect", default=ENDPOINT, help=f"the daemon's Zenoh endpoint ({ENDPOINT})")
    parser.add_argument("--prefix", default="tilth", help="as in the machine file (tilth)")
    parser.add_argument("--replay", action="store_true", help="hear a simulation")
    parser.add_argument("--interface", required=True, help="of python-can, for the commands")
    parser.add_argument("--channel", default="can0")
    parser.add_argument("--host", help="of a socketcand server")
    parser.add_argument("--port", type=int)
    parser.add_argument("--origin", type=float, nargs=2, required=True, metavar=("LAT", "LON"))
    work = Work()
    parser.add_argument("--rows", type=int, default=work.rows)
    parser.add_argument("--length", type=float, default=work.length, help="of a row, m")
    parser.add_argument("--spacing", type=float, default=work.spacing, help="of rows, m")
    parser.add_argument("--radius", type=float, default=work.radius, help="of turns, m")
    parser.add_argument("--gains", choices=("adapting", "fixed"), default="adapting")
    return parser


def main() -> int:
    options = arguments().parse_args()
    stopping: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda got, _: stopping.append(got))
    bus_options = {name: value for name in ("host", "port") if (value := getattr(options, name)) is not None}
    try:
        with Wires(
            options.machine, endpoint=options.connect, prefix=options.prefix, replay=options.replay
        ) as wires:
            return run(
                wires,
                options,
                lambda: can.Bus(interface=options.interface, channel=options.channel, **bus_options),
                lambda: bool(stopping),
            )
    except (ValueError, OSError, can.CanError) as error:
        sys.stderr.write(f"tilth.adaptive_guidance: {error}\n")
        return 2


def _say(fact: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(fact) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
