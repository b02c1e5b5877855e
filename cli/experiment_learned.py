"""What the runs of a plan have told, by a process of `tilth fit` over the log that was just written."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from tilth.logger.job import NO_ANSWER, Job, JobEnded
from tilth.logger.log.runs import stored_runs
from tilth.schemas.experiment import ExperimentPlan, edited
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.invocation import command, in_background
from tilth.schemas.spread import of_parameter, share

EDITED: Final = "The plan was edited after its numbers were predicted: nothing is expected of it."
_FAILED: Final = "Nothing could be fitted: {}"


class FitOfRuns:
    """Begins at once; `told` says how it stands, at any moment."""

    def __init__(self, plan: ExperimentPlan, logs: Sequence[str]) -> None:
        """logs: paths on the daemon's computer, which need not be this one."""
        self._plan, self._logs = plan, with_all_parts(logs)
        marks = ("--mark", f"experiment {plan.name} run * seed {plan.seed}")  # not those of other plans
        report = command("report", *self._logs, "--out", f"{plan.name}.html", "--fit", "all", *marks)
        self._commands = (report,) if logs else ()
        self._fit: Job | None = None
        self._lines: tuple[str, ...] = ()
        here = bool(logs) and all(Path(log).exists() for log in self._logs)
        words = in_background("fit", *self._logs, *marks, "--json") if here else []
        if not logs:
            self._lines = ("No log was heard of: look whether the daemon records.",)
        elif not words:
            fit = command("fit", *self._logs, *marks)
            self._lines = (f"The log is on the daemon's computer. What was learned says there: {fit}",)
        else:
            try:
                self._fit = Job(words)
                self._lines = ("Fitting what was driven; this may take a minute or two …",)
            except JobEnded as why:
                self._lines = (_FAILED.format(why),)

    @property
    def over(self) -> bool:
        return self._fit is None

    def told(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """(lines, commands for a terminal)."""
        if self._fit is not None and not self._fit.alive:
            self._lines = _lines(self._fit, self._plan)
            self.close()
        return self._lines, self._commands

    def close(self) -> None:
        """Ends it."""
        if self._fit is not None:
            self._fit.close()
            self._fit = None


def _lines(fit: Job, plan: ExperimentPlan) -> tuple[str, ...]:
    try:
        return lines_of(fit.json(), plan)
    except JobEnded as why:
        return (_FAILED.format(why),)
    except (LookupError, TypeError):
        return (_FAILED.format(NO_ANSWER),)


def lines_of(answer: Mapping[str, Any], plan: ExperimentPlan) -> tuple[str, ...]:
    """What `tilth fit --json` says, in lines: the six, beside what the plan expected, and whether the runs
    agree. Raises LookupError, TypeError where it is no such answer."""
    if answer["joint"] is None:
        return ("The runs tell nothing of the tyres: `tilth fit` says why of each.",)
    missing = _missing(answer["runs"], plan)
    predicted: Mapping[str, float] = {} if edited(plan) or missing else plan.predicted
    lines = []
    for name in PARAMETERS:
        row = answer["joint"]["parameters"][name]
        expected = f"; expected {share(predicted[name])}" if name in predicted else ""
        if row["value"] is None:
            lines.append(f"{name}: {row['reason']}{expected}")
            continue
        k = PARAMETERS.index(name)
        percent = share(math.sqrt(answer["joint"]["log_covariance"][k][k]), bare=True)
        lines.append(f"{name}: {of_parameter(name, row['value'], row['sd'])}, {percent}{expected}")
    if len(answer["runs"]) > 1:
        lines.append(answer["agreement"]["sentence"])
    if edited(plan):
        lines.append(EDITED)
    elif plan.predicted and missing:
        lines.append(missing)
    return tuple(lines)


def _missing(runs: Sequence[Mapping[str, Any]], plan: ExperimentPlan) -> str:
    """What a fit lacks of a plan, in a sentence; "" if every run is in it, once."""
    count, names = sum(run.replicates for run in plan.run), {one["name"].split(" try ")[0] for one in runs}
    if len(names) == len(runs) == count:
        return ""
    return (
        f"{len(names)} of the {count} runs are in this fit, in {len(runs)} tries: what was expected of the "
        "plan is of all of them, once each. If others are in an earlier log, give both to `tilth fit`."
    )


def with_all_parts(logs: Sequence[str]) -> list[str]:
    """Logs of runs, and what else was written of the same runs, where that is here."""
    found: dict[str, None] = {}
    for log in map(Path, logs):
        stored = [run for run in stored_runs(log.parent) if log in run.files]
        found |= dict.fromkeys(map(str, stored[0].files if stored else (log,)))
    return list(found)
