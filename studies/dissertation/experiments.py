"""The field experiments of chapter 7, driven by the virtual tractor: two fields, three manoeuvres, three
replicates, on either plant; each a log, made once and kept.

A field is a file of examples/scenarios/dissertation; another manoeuvre replaces its line of steering.
"""

import os
import re
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple

from tilth.analysis.runs.kept import key_of
from tilth.analysis.runs.run import Run, open_runs
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, files_of, simulate_to

FOLDER: Final = Path(__file__).resolve().parents[2] / "examples" / "scenarios" / "dissertation"
PLANTS: Final = ("planar", "spatial")
FIELDS: Final = ("first", "second")
REPLICATES: Final = (1, 2, 3)
AMPLITUDE_DEG: Final = 8.0  # the dissertation kept the wheels below 10 degrees
_STEERING: Final = re.compile(r"^steering = .*$", re.MULTILINE)
MANOEUVRES: Final[Mapping[str, str | None]] = {
    "steps": None,
    **{
        kind: f'steering = {{ kind = "{kind}", amplitude_deg = {AMPLITUDE_DEG} }}'
        for kind in ("chirp", "random")
    },
}
"""Name -> its line in a scenario file; None: that of the field's file."""
FITTED_S: Final = (1.0, 37.0)  # of each run: all but the first poses and the end


class Experiment(NamedTuple):
    """One run."""

    plant: str
    field: str
    manoeuvre: str
    replicate: int

    @property
    def name(self) -> str:
        return f"{self.field}_{self.manoeuvre}_{self.replicate}_{self.plant}"

    @property
    def seed(self) -> int:
        """No two runs of a plant have the same noise."""
        numbers = (FIELDS.index(self.field), list(MANOEUVRES).index(self.manoeuvre), self.replicate)
        return 100 * numbers[0] + 10 * numbers[1] + numbers[2]

    @property
    def text(self) -> str:
        """The scenario. Raises OSError."""
        text = (FOLDER / f"{self.field}_field_{self.plant}.toml").read_text(encoding="utf-8")
        line = MANOEUVRES[self.manoeuvre]
        return text if line is None else _STEERING.sub(line, text)

    @property
    def scenario(self) -> Scenario:
        """Raises OSError, ScenarioError."""
        return parse_scenario(self.text)


def all_of(plants: Iterable[str] = PLANTS) -> list[Experiment]:
    """Every run of these plants."""
    return [Experiment(*row) for row in product(plants, FIELDS, MANOEUVRES, REPLICATES)]


def truth(field: str) -> dict[str, float]:
    """What the simulation of a field is given: PARAMETERS, N/rad and m; on both plants the same."""
    (one, other) = (Experiment(plant, field, "steps", 1).scenario.soil.parameters for plant in PLANTS)
    assert one is not None and one == other, field
    found = {str(name): value for name, value in one.items()}
    return {name: found[name] for name in PARAMETERS}


def machine_text() -> str:
    """Of the packaged machine file, which has the parameters of Table 7.2 as priors."""
    return packaged_file().text


def made(experiment: Experiment, folder: Path) -> Path:
    """Its log, simulated unless it is there. Raises OSError."""
    text, machine = experiment.text, machine_text()
    log = folder / f"{experiment.name}_{key_of(text, machine, experiment.seed)[:8]}.mcap"
    if log.exists():
        return log
    folder.mkdir(parents=True, exist_ok=True)
    scenario = experiment.scenario
    source = SimulationInput(
        parse_machine(machine), machine, scenario, text, experiment.seed, scenario.seconds
    )  # fmt: skip
    unfinished = folder / f"{os.getpid()}.mcap"
    for path in files_of(unfinished):
        path.unlink(missing_ok=True)
    for path, final in zip(simulate_to(source, unfinished).files[::-1], files_of(log)[::-1], strict=True):
        path.replace(final)  # the log last: while it is missing the run is made again
    return log


def opened(experiment: Experiment, folder: Path) -> Run:
    """Its run, replayed unless that is kept. Raises OSError, LogError."""
    (run,) = open_runs(made(experiment, folder), cache=folder)
    return run


def prepare(experiments: Iterable[Experiment], folder: Path, jobs: int) -> None:
    """Make and replay what is not kept, side by side. Raises OSError, LogError."""
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        for done in [pool.submit(opened, experiment, folder) for experiment in experiments]:
            done.result()
