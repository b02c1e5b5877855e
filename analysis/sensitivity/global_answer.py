"""What `tilth sensitivity --global` answers, as plain data: sensitivities over many rigs, what makes the
variance of each output, and where rigs are unstable."""

from typing import Any, Final, cast

import numpy as np

from tilth.analysis.sensitivity.accumulators import Kept, mean, quantile, spread
from tilth.analysis.sensitivity.answers import Domain, GlobalAnswer, GlobalRow, IndicesAnswer, finite
from tilth.analysis.sensitivity.run_batches import GlobalPlan, Part
from tilth.analysis.sensitivity.stable_domain import Corner, clearest, pair_answer
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import RIG_PARAMETERS

INDICES: Final = ("sobol_first", "sobol_total", "morris", "dgsm_bound")
_UNITS: Final = {row.name: row.unit for row in RIG_PARAMETERS}


def global_answer(plan: GlobalPlan, part: Part) -> GlobalAnswer:
    """Without the indices, which `with_indices` fills in. The outer numbers of "global" are of the mean over
    the outputs (6.17)."""
    design = plan.design
    counts = {
        name: (np.diagonal(part.unstable[k, k]), np.diagonal(part.there[k, k]))
        for k, name in enumerate(design.names)
    }
    domain = clearest(design, part.there, part.unstable)
    total = int(part.unstable[0, 0].sum())
    return {
        "points": design.size,
        "simulations": design.size * (len(design.names) + 1),
        "global_outputs": list(plan.outputs),
        "unstable_share": total / design.size,
        "global": _numbers(plan, part.every, indices=True),
        "global_stable": _numbers(plan, part.stable, indices=False),
        "unstable_by_level": {
            name: (bad / np.maximum(there, 1)).tolist() for name, (bad, there) in counts.items()
        },
        "unstable_where": _where(plan, part),
        "unstable_domain": _domain(domain),
        "unstable_pairs": pair_answer(
            model_named(plan.model), plan.rig, plan.speed, design, part.there, part.unstable
        ),
    }


def _numbers(plan: GlobalPlan, kept: Kept, *, indices: bool) -> dict[str, GlobalRow]:
    columns = {
        "mean": mean(kept),
        "sd": spread(kept),
        "median": quantile(kept, 0.5),
        "q05": quantile(kept, 0.05),
        "q95": quantile(kept, 0.95),
    }
    shape = (len(plan.design.names), len(plan.measures))
    found: dict[str, GlobalRow] = {}
    for k, name in enumerate(plan.design.names):
        rows: list[Any] = [
            {key: finite(float(values.reshape(shape)[k, m])) for key, values in columns.items()}
            for m in range(shape[1])
        ]
        empty = dict.fromkeys(INDICES[:2]) if indices else {}
        by_output = dict(zip(plan.outputs, rows[1:], strict=True))
        found[name] = rows[0] | empty | {"by_output": by_output}
    return found


def with_indices(answer: GlobalAnswer, found: IndicesAnswer) -> None:
    """Fill what `indices_answer` found into "global" of a `global_answer`; its counts become "indices"."""
    for name, row in answer["global"].items():
        row.update(cast("GlobalRow", found["overall"][name]))
        for output, rows in found["outputs"].items():
            indices = cast("GlobalRow", rows[name])
            row["by_output"].setdefault(output, cast("GlobalRow", {})).update(indices)
    answer["indices"] = {"points": found["points"], "lost": found["lost"]}


def _where(plan: GlobalPlan, part: Part) -> str:
    """Which parameters make rigs unstable, and which side of their range."""
    if not part.unstable.any():
        return "none of them is unstable"
    said = []
    for k, name in enumerate(plan.design.names):
        row = np.diagonal(part.unstable[k, k])
        if max(row[0], row[-1]) >= 2 * min(row[0], row[-1]):
            said.append(f"{name} {'high' if row[-1] > row[0] else 'low'}")
    return f"unstable: {', '.join(said)}" if said else "unstable points lie all over the box"


def _domain(corner: Corner | None) -> Domain | None:
    return None if corner is None else cast("Domain", {"text": in_words(corner), **corner._asdict()})


def in_words(corner: Corner) -> str:
    """A sentence."""
    sides = [
        f"{name} {'from' if high else 'up to'} {_rounded(end)} {_UNITS[name]}{' up' if high else ''}"
        for name, high, end in zip(corner.names, corner.high, corner.ends, strict=True)
    ]
    return (
        f"{_percent(corner.holds)} of the unstable rigs have {' and '.join(sides)}; of all rigs there "
        f"{_percent(corner.unstable)} are unstable"
    )


def _rounded(value: float) -> str:
    """To four digits, not in powers of ten; above zero."""
    places = 3 - int(np.floor(np.log10(value)))
    text = f"{round(value, places):,.{max(places, 0)}f}".replace(",", " ")
    return text.rstrip("0").rstrip(".") if places > 0 else text


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
