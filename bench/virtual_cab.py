"""A plan of experiments without a tractor: a virtual one, a daemon and a driver, all in real time.

    python bench/virtual_cab.py PLAN.toml [--wait] [--log DIR]

`tilth experiment PLAN.toml` in another terminal then prompts this driver, and `tilth monitor` shows it. He
follows the bar as a person does, half a second late, and turns round at the ends of the plan's field. He arms
each run where there is room ahead; with --wait somebody else does.
"""

import argparse
import logging
import signal
import sys
from pathlib import Path

from prompted_live import virtual_cab

from tilth.cli import WrongUse
from tilth.logger.daemon import run_daemon
from tilth.schemas.experiment import ExperimentPlan, PlanError, parse_plan
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.packaged import packaged_file
from tilth.simulator.prompted_driver import Person
from tilth.simulator.scenario import Ground, Scenario, Soil

SECONDS = 7200.0  # at most
ROUGH = Ground(roll_sd_deg=0.7, force_sd=0.015)


def plan_of(path: Path, machine: str) -> ExperimentPlan:
    """Raises WrongUse where the virtual tractor is another."""
    try:
        plan = parse_plan(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, PlanError) as error:
        raise WrongUse(f"{path}: {error}") from None
    if plan.machine != machine:
        raise WrongUse(f'{path} is for machine = "{plan.machine}"; the virtual tractor is {machine}')
    if plan.field.corner is not None:
        raise WrongUse(f"{path}: the virtual tractor is not at field.corner; leave it out, and heading_deg")
    return plan


def drive(plan: ExperimentPlan, path: Path, text: str, log: Path, arms: bool) -> None:
    """Until Ctrl-C."""
    speed, field = plan.run[0].speed, plan.field
    scenario = Scenario(speed=speed, other_traffic=False, soil=Soil(grip=0.7, rolling=0.06), ground=ROUGH)
    lane = (0.0, 0.0, 0.0, field.length - 2 * field.headland)  # from where the field without a corner begins
    stopping = []
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, lambda *_: stopping.append(True))
    with virtual_cab(text, scenario, Person(), 1, SECONDS, lane, arms) as cab:
        print(f"The tractor drives at {3.6 * speed:.1f} km/h until Ctrl-C. In other terminals:")
        print(f"  uv run tilth experiment {path} --connect {cab.endpoint}")
        print(f"  uv run tilth monitor --connect {cab.endpoint}", flush=True)
        summary = run_daemon(
            MachineFile(cab.machine, cab.text), log_folder=log, simulated="bench/virtual_cab.py",
            stop=lambda: bool(stopping) or cab.over,
        )  # fmt: skip
        late = cab.stop()
    if not stopping:
        print(f"The tractor has driven for {SECONDS / 3600:g} hours, which is its longest: begin anew.")
    if late:
        print(f"This computer was too busy for real time: {late} steps of the tractor came late.")
    print(f"Log: {' '.join(map(str, summary.log_files))}")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("plan", type=Path, metavar="PLAN.toml")
    parser.add_argument("--wait", action="store_true", help="let somebody else arm the runs")
    parser.add_argument(
        "--log", type=Path, default=Path("logs"), metavar="DIR", help="folder of the log (logs)"
    )
    args = parser.parse_args()
    logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)  # it warns at each half-read frame
    machine, text = packaged_file()
    try:
        plan = plan_of(args.plan, machine.name)
    except WrongUse as error:
        print(error, file=sys.stderr)
        return 2
    if any(run.speed != plan.run[0].speed for run in plan.run):
        print("The tractor drives at the speed of the first run; skip those at another speed.")
    drive(plan, args.plan, text, args.log, not args.wait)
    return 0


if __name__ == "__main__":
    sys.exit(main())
