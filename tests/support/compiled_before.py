"""Compiles kernels that several tests call besides those of a machine's estimators.
Else processes that run at once would each compile them."""

from contextlib import suppress

from logs import MACHINE

from tilth.analysis.sensitivity.designs import DISSERTATION, Uniform
from tilth.analysis.sensitivity.run_batches import GlobalPlan, part_of
from tilth.estimator.models.parameters import TABLE_7_2
from tilth.simulator.drive import drive
from tilth.simulator.scenario import Scenario
from tilth.simulator.spatial.engine import NotInstalled


def main() -> None:
    part_of(GlobalPlan("relaxation", TABLE_7_2, 7.5, 0.1, Uniform(DISSERTATION, 1)), 0, 1)
    with suppress(NotInstalled):
        drive(MACHINE, 1, 0.1, Scenario(plant="spatial"))


if __name__ == "__main__":
    main()
