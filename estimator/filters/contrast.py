"""Whether a fit stands without its model of the ground: a specification test after Hausman (1978).

In the filter what the ground does to the axles is independent and of one colour, while one rut meets them
one after the other. If that did no harm, two estimates of the six would agree within chance: the fit's, which
uses all of the record, and one that needs no model of the ground: what the filter leaves, regressed on its
own past (free_noise.py), against slopes along the path that the steering alone gives. That one knows less, so
the variance of the difference is its variance less the fit's. What the square of the difference has beyond
this is the variance of the fit's error, by the method of moments, as of a random effect (DerSimonian and
Laird 1986). It is the same in all windows, so more driving does not take it away.

Scores and information of windows add up, so both are solved anew over all of them since the soil changed. One
window of 30 s seldom shows anything, and the ground's error is in the prior of the next one already: so these
begin from the machine file's. The value stays the fit's: on a stranger's heavy rigs the other one had half of
the error of C_ar, on rigs of the virtual fleet twice that of C_ai.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.free_noise import gradient_and_information, regress
from tilth.estimator.filters.likelihood import (
    ROLL_MODES,
    Iterate,
    Search,
    inverse,
    once_for_a_search,
    whitened_by_steering,
)
from tilth.estimator.filters.plain_row import OUTPUTS, epochs_of, output_of, positions_of
from tilth.estimator.filters.row_fit import ROW_FIT, order_at
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import NAMES, NOISES
from tilth.estimator.record.record import OFFSET, PLACE, PSI, TICK, Record, U
from tilth.estimator.state_json import Shape

Array = NDArray[np.float64]

MOTION: Final = np.array([k for k, name in enumerate(NAMES) if name not in NOISES])
"""Indices of unknowns.NAMES: all that windows have in common. The six come first."""
_ROLL: Final = np.isin(MOTION, ROLL_MODES)
_K: Final = len(MOTION)


@dataclass(frozen=True, slots=True)
class Contrast:
    """What windows told of MOTION, as their fits have it, and by steering and past."""

    information: Annotated[Array, Shape((2, _K, _K))] = field(default_factory=lambda: np.zeros((2, _K, _K)))
    vector: Annotated[Array, Shape((2, _K))] = field(default_factory=lambda: np.zeros((2, _K)))
    """Information times where either would end alone."""
    excess: Annotated[Array, Shape((6,))] = field(default_factory=lambda: np.zeros(6))
    """Sds of the six of the error that chance does not explain."""

    def faded(self, share: float) -> "Contrast":
        """With the weight of what was told, 0 to 1."""
        return replace(self, information=share * self.information, vector=share * self.vector)


class ToldOfMotion(NamedTuple):
    """What a window tells of the k active ones of MOTION at a point, without the prior."""

    gradient: Array  # (k,), of the cost in nats
    information: Array  # (k, k)


def joined(
    before: Contrast, window: Contrast, prior: tuple[Array, Array], fitted: tuple[Array, Array]
) -> Contrast:
    """What was told before and of a window, with the excess of both. prior: mean and sds of the machine
    file, (n,). fitted: mean and covariance of the window's fit, (n,) and (n, n).

    How bodies swing is shown by how the ground shakes them, so what the fit says of that stands.
    """
    information, vector = before.information + window.information, before.vector + window.vector
    spread, middle = np.diag(prior[1][MOTION] ** 2), np.where(_ROLL, fitted[0][MOTION], prior[0][MOTION])
    spread[np.ix_(_ROLL, _ROLL)] = fitted[1][np.ix_(MOTION[_ROLL], MOTION[_ROLL])]
    at = np.flatnonzero(np.diag(spread) > 0.0)
    known, six = inverse(spread[np.ix_(at, at)]), at < 6
    ends, variances = np.zeros((2, 6)), np.zeros((2, 6))
    for k in range(2):
        covariance = inverse(information[k][np.ix_(at, at)] + known)
        ends[k, at[six]] = (covariance @ (vector[k, at] + known @ middle[at]))[six]
        variances[k, at[six]] = np.diag(covariance)[six]
    narrow, wide = np.sqrt(variances)
    # At least as of two that go together wholly: the past may leave less noise than the fit has.
    by_chance = np.maximum(wide**2 - narrow**2, (wide - narrow) ** 2)
    return Contrast(information, vector, np.sqrt(np.maximum((ends[1] - ends[0]) ** 2 - by_chance, 0.0)))


def contrast_of(search: Search, left: Iterate, information: Array) -> Contrast:
    """Of a window. left: where its fit has ended, as `likelihood.apart_from_ground`; information: (a, a), of
    that, with the prior. Nothing where the response to steering alone runs away."""
    moving, found = search.of_motion, Contrast()
    places = search.active[moving]
    e, slopes = whitened_by_steering(search, left.point, places, once_for_a_search(search, left.point))
    if not (np.all(np.isfinite(slopes)) and slopes[:, places < 6].any()):
        return found
    weighted = left.de[moving] * (search.scored / np.sqrt(left.S))
    of_fit = ToldOfMotion(weighted @ e, (information - search.prior_information)[np.ix_(moving, moving)])
    into = np.searchsorted(MOTION, places)
    for k, told in enumerate((of_fit, told_beside(search, e, slopes))):
        found.information[k][np.ix_(into, into)] = told.information
        found.vector[k, into] = told.information @ left.point[places] - told.gradient
    return found


def told_beside(search: Search, e: Array, slopes: Array, past: bool = True) -> ToldOfMotion:
    """By innovations over their sds, (m,), and their slopes, (m, k). past: whether these are regressed on
    theirs."""
    columns = across_bodies(search.record, np.column_stack([e, slopes]))
    outputs, others = in_epochs(search, columns)
    gradient, information = others[:, 1:].T @ others[:, 0], others[:, 1:].T @ others[:, 1:]
    if not past or outputs.shape[1] == 0:
        flat = outputs.reshape(-1, outputs.shape[2])
        return ToldOfMotion(gradient + flat[:, 1:].T @ flat[:, 0], information + flat[:, 1:].T @ flat[:, 1:])
    order = min(order_at(float(np.mean(search.record.ticks[:, U])), search.setup), len(outputs) // 3)
    noise = regress([outputs[:, :, 0]], order)
    of_outputs, told = gradient_and_information(noise, [outputs[:, :, 1:]])
    return ToldOfMotion(gradient + of_outputs, information + told)


def across_bodies(record: Record, columns: Array) -> Array:
    """Of columns, (m, k), of whitened innovations: those of positions along and across their bodies, in place
    of north and east. A rotation leaves white what is white."""
    rows = record.rows
    north, east = positions_of(rows)
    psi = record.ticks[rows[east, TICK].astype(np.int64), PSI + (rows[east, PLACE] >= 2)][:, None]
    turned = columns.copy()
    turned[north] = np.cos(psi) * columns[north] + np.sin(psi) * columns[east]
    turned[east] = np.cos(psi) * columns[east] - np.sin(psi) * columns[north]
    return turned


def in_epochs(search: Search, columns: Array) -> tuple[Array, Array]:
    """Columns, (m, k), as (those of OUTPUTS that are in nearly all settled epochs (n, c, k), the scored rows
    of no such output (r, k))."""
    rows, scored = search.record.rows, search.scored > 0.0
    epoch = epochs_of(rows[:, TICK] * DT + rows[:, OFFSET])
    epoch -= epoch[scored].min(initial=epoch.max())
    output = output_of(rows)
    slots, counted = epoch * len(OUTPUTS) + output, (output >= 0) & scored
    rows_in = np.bincount(slots[counted], minlength=(int(epoch.max()) + 1) * len(OUTPUTS))
    present = np.mean(rows_in.reshape(-1, len(OUTPUTS)) > 0, axis=0) > ROW_FIT.present
    chosen = counted & present[output]
    made = np.zeros((len(rows_in), columns.shape[1]))
    np.add.at(made, slots[chosen], columns[chosen] / np.sqrt(rows_in[slots[chosen]])[:, None])
    return made.reshape(-1, len(OUTPUTS), columns.shape[1])[:, present], columns[scored & ~chosen]
