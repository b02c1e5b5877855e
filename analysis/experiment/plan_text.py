"""A plan as TOML that people edit: keys of schemas/experiment.py, with what a run is for beside it."""

import json
from typing import Any, Final

from pydantic import BaseModel

from tilth.analysis.experiment.propose import Compared, Proposal
from tilth.estimator.models.manoeuvres import manoeuvre_named
from tilth.schemas.experiment import AnyRun, ChirpRun, RandomRun, StepsRun
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import share

_HEAD: Final = """\
# A plan of experiments, proposed by `tilth experiment --propose`{source}. Edit what you like; then
# `tilth experiment {path}` beside a running daemon prompts a driver through it. Nothing starts by itself.
# What is predicted here holds for the runs as they are: of edited ones nothing is expected.
#
# {worth}
"""


def text_of(proposal: Proposal, path: str, source: str = "") -> str:
    """source: what it started from, in words; "" for the machine file alone."""
    plan = proposal.plan
    lines = [_HEAD.format(source=f" from {source}" if source else "", path=path, worth=worth(proposal))]
    lines += [f"name = {_value(plan.name)}", f"machine = {_value(plan.machine)}"]
    lines += [f"seed = {plan.seed}  # of the order and of random steering"]
    lines += [f"countdown_s = {plan.countdown_s:g}"]
    lines += _predicted("predicted", plan.predicted, "by all runs, as `tilth fit` will give it")
    lines += _predicted("predicted_with_log", plan.predicted_with_log, f"by {source} and all runs")
    lines += [f"predicted_for = {_value(plan.predicted_for)}  # the runs below, unedited", ""]
    lines += ["[limits]", *_keys(plan.limits), ""]
    lines += ["[field]  # without a corner its near headland ends where the first run is armed"]
    lines += [*_keys(plan.field), ""]
    for run in plan.run:
        lines += _run(run)
    return "\n".join(lines)


def worth(proposal: Proposal) -> str:
    """What a plan brings, in a few sentences."""
    least = int(proposal.sd.argmax())
    name, left = PARAMETERS[least], share(float(proposal.sd[least]))
    what = f"{proposal.seconds:.0f} s of steering"
    if proposal.told_already:
        return (
            f"The log has told nearly all that {what} could tell: {name} stays known least, {left} where the "
            "last run is. Harder limits, another speed or other kinds may tell more."
        )
    what += f" leave {name} known least, {left}"
    if proposal.plan.predicted_with_log:
        alone = share(float(proposal.before[least]))
        what = f"With what the log has told, {what} where the last run is; there the log alone leaves {alone}"
    return (
        f"{what}. To be as good, held steps {_compared(proposal, proposal.held)}, and steps of three seconds "
        f"to either side {_compared(proposal, proposal.swung)}."
    )


def _compared(proposal: Proposal, other: Compared | None) -> str:
    if other is None:
        return "have no room in this field"
    bound = "" if other.reached else "more than "
    return f"take {bound}{other.seconds:.0f} s ({bound}{other.seconds / proposal.seconds:.1f} times as long)"


def _run(run: AnyRun) -> list[str]:
    lines = [f"[[run]]  # {_purpose(run)}", f"kind = {_value(run.kind)}", *_keys(run, ("kind", "predicted"))]
    return [*lines, *_predicted("predicted", run.predicted, "by its replicates alone"), ""]


def _purpose(run: AnyRun) -> str:
    """What a kind is, with the numbers of this run where its words have any."""
    match run:
        case StepsRun():
            return f"to one side and the other, {run.hold_s:g} s each"
        case ChirpRun():
            return f"swinging from {run.low_hz:g} to {run.high_hz:g} Hz"
        case RandomRun():
            return f"random levels, held for {run.shortest_s:g} to {run.longest_s:g} s"
    return manoeuvre_named(run.kind).meaning


def _predicted(key: str, found: Any, of: str) -> list[str]:
    if not found:
        return []
    inside = ", ".join(f"{name} = {value:g}" for name, value in found.items())
    return [f"{key} = {{ {inside} }}  # sd of the logarithms {of}; 1.96 times that is 95 %"]


def _keys(section: BaseModel, without: tuple[str, ...] = ()) -> list[str]:
    """What has a value, and beside it what it means, with its unit."""
    lines = []
    for key, field in type(section).model_fields.items():
        value = getattr(section, key)
        if value is not None and key not in without:
            meaning = f"  # {field.description}" if field.description else ""
            lines.append(f"{key} = {_value(value)}{meaning}")
    return lines


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)
