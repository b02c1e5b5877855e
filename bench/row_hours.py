"""Many blocks of rows one after the other, with nothing changing: driven, or told by what one row told.

Ten hours of driving take hours of computing. What the method does with them, its drift, its test of a change
and what it publishes, is linear in what each block tells: so a row that was driven stands for all blocks by
its information, each block errs by chance as that says, and the model errs in all of them alike.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from estimation_table import Line, Z, percents
from numpy.typing import NDArray

from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem, rows
from tilth.estimator.results.method_state import drifted
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]
Result = dict[str, Any]

LEAST_HELD: Final = 0.92
OVER_BOUND: Final = 1.3
LEAST_SD: Final = 0.03


def of_block(error: Array, sd: Array, bound: Array, refused: str | None, changed: bool) -> Result:
    """What is said after a block, of the six."""
    return {
        "error": error.tolist(), "sd": sd.tolist(), "bound": bound.tolist(), "refused": refused,
        "changed": changed,
    }  # fmt: skip


def in_pieces(
    machine: Machine, row: Array, times: float, metres: float, count: int, seed: int
) -> list[Result]:
    """What the method says after each of `count` blocks of so many metres.

    row: (n, n), the covariance after a row from the prior of the machine file; a block tells `times` as much.
    """
    state, rng = rows.initial(machine), np.random.default_rng(seed)
    model_sd = np.full(6, rows.TUNING.model_sd)
    covariance = pem.with_known_masses(state.covariance)
    active = np.flatnonzero(np.diag(covariance) > 0.0)
    at, prior = np.ix_(active, active), np.linalg.inv(covariance[np.ix_(active, active)])
    sizes, axes = np.linalg.eigh(np.linalg.inv((row - pem.of_masses(state.covariance))[at]) - prior)
    told = times * (axes * np.maximum(sizes, 0.0)) @ axes.T  # filters differ: not less than nothing
    by_chance = axes * np.sqrt(times * np.maximum(sizes, 0.0))
    true, mean, out = np.sqrt(np.diag(covariance)[active]) * rng.standard_normal(len(active)), 0.0, []
    found = true.copy()
    found[SIX] += model_sd * rng.standard_normal(6)
    for block in range(1, count + 1):
        known = drifted(state, covariance, metres if block > 1 else 0.0)
        covariance = known.copy()
        covariance[at] = np.linalg.inv(np.linalg.inv(known[at]) + told)
        off = told @ (found - mean) + by_chance @ rng.standard_normal(len(active))
        moved = covariance[at] @ off
        mean = mean + moved
        chi_square = pem.contradiction(moved[SIX], known[SIX, SIX], covariance[SIX, SIX], model_sd)
        sd = np.sqrt(np.diag(covariance)[SIX] + model_sd**2)
        bound = np.sqrt(np.diag(np.linalg.inv(prior + block * told))[SIX])
        changed = chi_square > rows.TUNING.change_chi_square
        out.append(of_block((mean - true)[SIX], sd, bound, None, changed))
    return out


def hours_lines(made: Sequence[Result]) -> list[Line]:
    """What is said after the first block, half of them, and at the end. made: each with its `blocks`."""
    driven = [one["blocks"] for one in made if "blocks" in one]
    used = [blocks for blocks in driven if not all(block["refused"] for block in blocks)]
    lines = [
        Line("could not be driven", f"rigs {[one['rig'] for one in made if 'blocks' not in one]}"),
        Line("withheld", f"{len(driven) - len(used)} of {len(driven)}"),
    ]
    if not used:
        return lines
    for name, at in (("first block", 0), ("half of them", len(used[0]) // 2), ("end", -1)):
        error, sd, bound = (
            np.array([blocks[at][key] for blocks in used]) for key in ("error", "sd", "bound")
        )
        z = error / sd
        over = sd / np.maximum(OVER_BOUND * np.hypot(bound, rows.TUNING.model_sd), LEAST_SD)
        sizes = "; ".join(
            percents(np.median(np.abs(each), axis=0).tolist(), 0) for each in (error, sd, bound)
        )
        lines.append(Line(
            name,
            f"{int(np.sum(np.abs(z) < Z))} of {z.size} hold, z {np.mean(z):+.2f} ± {np.std(z):.2f}, largest "
            f"{np.abs(z).max():.1f}; |error|, sd, bound: {sizes}; sd over its limit, largest: "
            + percents(over.max(axis=0).tolist(), 0),
            "92 %; sd ≤ 1.3 times bound with the model's part, or 3 %",
            bool(np.mean(np.abs(z) < Z) >= LEAST_HELD and np.all(over <= 1.0)), (float(np.mean(z)),),
        ))  # fmt: skip
    changes = sum(block["changed"] for blocks in used for block in blocks)
    figure = f"{changes} in {sum(map(len, used))} blocks"
    return [*lines, Line("false changes of soil", figure, "0", changes == 0, (changes,))]
