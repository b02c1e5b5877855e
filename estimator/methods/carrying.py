"""What a change of the implement's load does to what the methods have learned.

Stiffnesses are learned over masses that are taken as known. With another load the prior's means move as tyres
follow their load, and what was learned moves with them, as uncertain as the exponent is.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.soil_field import SoilWindow
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.methods.pem import of_masses, with_known_masses
from tilth.estimator.methods.place import PlaceState
from tilth.estimator.methods.rows import RowsState
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.models.load import LOAD, heavier_by, moved_by
from tilth.estimator.results.method_state import SixState
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

OF_LADEN: Final = [AT[name] for name in ("roll_k_i", "roll_d_i", "roll_j_i", "roll_cg_i", "cg_i", "m_i")]
"""Of the implement with its load: with another one nothing of them is known but the prior."""
STIFFNESSES: Final = slice(0, 3)
RELAXATIONS: Final = slice(3, 6)


def take_load(state: Any, before: Machine, after: Machine) -> None:
    """Go on with another load. state: of a method that learns the six, or of the memory by place; before,
    after:
    the rig with either load."""
    mean, sd = unknowns.prior(after)
    loads = np.abs(heavier_by(before, after))
    load = after.implement.load
    by_load, added = (load.exponent.sd if load else 0.0) * loads, np.zeros((6, 6))
    added[STIFFNESSES, STIFFNESSES] = np.outer(by_load, by_load)
    added[RELAXATIONS, RELAXATIONS] = np.diag((LOAD.relaxation * loads) ** 2)
    if isinstance(state, PlaceState):  # which keeps what windows told less the prior's mean
        state.prior_mean, state.prior_sd = mean, sd
        _less_sure(state, added)
        return
    state.mean += mean - state.prior_mean
    state.prior_mean, state.prior_sd = mean, sd
    _widen(state, added, OF_LADEN if loads[2] > LOAD.small_change else [])


def open_up(state: Any, machine: Machine, variance: float, but: Collection[SoilWindow] = ()) -> None:
    """The logarithm of the implement's mass may have moved, by that variance, and nobody has said it. but: of
    the memory by place, windows for which that is not new."""
    if isinstance(state, SixState):
        _widen(state, moved_by(machine, variance), [])
    elif isinstance(state, PlaceState):
        _less_sure(state, moved_by(machine, variance), but)


def _less_sure(state: PlaceState, added: Array, but: Collection[SoilWindow] = ()) -> None:
    """Add a covariance, (6, 6), to what windows have told, but for some."""
    if not state.windows or not added.any():
        return
    windows, kept_as_they_are = [], set(map(id, but))
    for window in state.windows:
        if id(window) in kept_as_they_are:
            windows.append(window)
            continue
        told = window.told
        kept = np.linalg.inv(np.eye(6) + told.information @ added)
        information = kept @ told.information
        told = replace(told, information=(information + information.T) / 2.0, vector=kept @ told.vector)
        windows.append(replace(window, told=told))
    state.windows, state.soil = windows, None


def _widen(state: SixState, added: Array, forgotten: list[int]) -> None:
    """Add a covariance to the six, none beyond the prior's variance; and forget what was learned of
    others."""
    covariances = [state.covariance]
    if isinstance(state, RowsState) and not state.block.ended:  # else what it is fitted from is of before
        covariances.append(state.before_covariance)
    masses = of_masses(np.diag(state.prior_sd**2))
    for covariance in covariances:
        learned = isinstance(state, TrackerState)  # with masses as known
        known = covariance if learned else with_known_masses(covariance)
        free = np.maximum(state.prior_sd[SIX] ** 2 - np.diag(known)[SIX], 0.0)
        wanted = np.diag(added)
        share = np.sqrt(np.minimum(1.0, free / np.where(wanted > 0.0, wanted, 1.0)))
        known[SIX, SIX] += added * np.outer(share, share)
        for k in forgotten:
            known[k, :] = known[:, k] = 0.0
            known[k, k] = 0.0 if k in unknowns.MASSES else state.prior_sd[k] ** 2
        covariance[:] = known if learned else known + masses
    state.mean[forgotten] = state.prior_mean[forgotten]
    if isinstance(state, TrackerState):
        state.P_xtheta[:, forgotten] = 0.0
        state.checkpoints.clear()
