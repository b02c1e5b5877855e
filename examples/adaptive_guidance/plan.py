"""The field's plan: where both bodies are to be along rows and headland turns, if no tyre slipped.

The tractor's rear axle follows straight rows and turns of smooth curvature; the rest follows from wheels that
roll where they point (Karkee 2009, 3.2 to 3.9, with full trigonometry). The implement's CG draws the line
that it is to keep to. Nothing here depends on the soil.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]

STEP: Final = 0.1  # m along the rear axle's path
RAMP: Final = 8.0  # m over which the curvature of a turn comes and goes
BACK, AHEAD = 20, 60  # samples of the plan in which an implement is looked for
RUN_IN: Final = 15.0  # m of the next row in which the implement still swings into line: part of the turn


@dataclass(frozen=True, slots=True)
class Work:
    """Rows to and fro, the first one northwards from the origin, each next one to the east. m."""

    rows: int = 5
    length: float = 120.0
    spacing: float = 36.0
    radius: float = 12.0  # of the rear axle, in turns
    rows_before: int | None = None  # the soil changes; None: half of them
    beside: float | None = None  # of a row, the next but one: two lands are worked at once; None: one land


@dataclass(frozen=True, slots=True)
class Plan:
    """Samples STEP apart along the rear axle's path; arrays of shape (n,) unless said. SI, frame W."""

    tractor: Array  # (n, 3): north and east of the CG, heading, not wrapped
    implement: Array  # (n, 3)
    curvature: Array  # 1/m: yaw of the tractor for each metre
    implement_curvature: Array  # 1/m: yaw of the implement for each metre of the tractor's rear axle
    wheel_angle: Array
    force: Array  # (n, 3): see `_forces`
    row: NDArray[np.int64]  # number of the row, from 0; -1 - k in the turn after row k


class Along:
    """Where an implement is along its line, asked for in the order of its way."""

    def __init__(self, line: Plan) -> None:
        self._line = line.implement[:, :2]
        way = np.gradient(self._line, axis=0)
        self._way = way / np.hypot(way[:, 0], way[:, 1])[:, None]
        self._at = 0

    def error(self, x: float, y: float) -> tuple[float, int]:
        """(how far its CG is to the right of the line, m; the nearest sample)."""
        first = max(self._at - BACK, 0)
        off = np.array([x, y]) - self._line[first : self._at + AHEAD]
        nearest = int(np.argmin(np.hypot(off[:, 0], off[:, 1])))
        self._at = first + nearest
        north, east = self._way[self._at]
        return float(off[nearest, 1] * north - off[nearest, 0] * east), self._at


def plan(work: Work, rig: Rig) -> Plan:
    """The plan of a field for the geometry of a rig. Raises ValueError where the turn does not fit."""
    curvature, row = _curvature(work)
    middle = curvature[:-1]
    psi = np.concatenate([[0.0], np.cumsum(middle * STEP)])
    steps = STEP * np.column_stack(
        [np.cos(psi[:-1] + middle * STEP / 2), np.sin(psi[:-1] + middle * STEP / 2)]
    )
    axle = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    psi_i = _towed(curvature, psi, rig)
    ahead, ahead_i = (np.column_stack([np.cos(p), np.sin(p)]) for p in (psi, psi_i))
    hitch = axle - (rig.c - rig.b) * ahead
    tractor = np.column_stack([axle + rig.b * ahead, psi])
    implement = np.column_stack([hitch - rig.d * ahead_i, psi_i])
    curvature_i = np.gradient(psi_i, STEP)
    force = _forces(tractor, implement, curvature, curvature_i, rig)
    return Plan(tractor, implement, curvature, curvature_i, np.arctan(rig.wheelbase * curvature), force, row)


def _curvature(work: Work) -> tuple[Array, NDArray[np.int64]]:
    """Curvature of the rear axle's path, and the number of the row, at each sample."""
    quarter = _quarter(work.radius)
    across = _shift(quarter)
    back = work.spacing if work.beside is None else work.spacing - work.beside
    if back < 2 * across:
        raise ValueError(f"rows {back:g} m apart need turns of a smaller radius than {work.radius:g} m")
    straight, run_in = round(work.length / STEP), round(RUN_IN / STEP)
    pieces, rows = [np.zeros(straight)], [np.zeros(straight, np.int64)]
    for k in range(1, work.rows):
        between = np.zeros(round(((work.spacing if k % 2 else back) - 2 * across) / STEP))
        turn = np.concatenate([quarter, between, quarter])
        side = 1.0 if k % 2 or work.beside is not None else -1.0  # at the northern end to the right
        pieces += [side * turn, np.zeros(straight)]
        number = np.full(straight, k)
        number[:run_in] = -k
        rows += [np.full(len(turn), -k), number]
    return np.concatenate(pieces), np.concatenate(rows)


def _quarter(radius: float) -> Array:
    """Curvature of a right turn by 90°."""
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(round(RAMP / STEP)) + 0.5) / round(RAMP / STEP))
    held = max(0, round((radius * math.pi / 2 - RAMP) / STEP))
    shape = np.concatenate([ramp, np.ones(held), ramp[::-1]])
    return np.asarray(shape * (math.pi / 2) / (shape.sum() * STEP))


def _shift(quarter: Array) -> float:
    """How far a quarter turn goes to the side, m."""
    psi = np.cumsum(quarter * STEP) - quarter * STEP / 2
    return float(np.sum(np.sin(psi)) * STEP)


def _towed(curvature: Array, psi: Array, rig: Rig) -> Array:
    """Heading of the implement: its axle rolls where it points, its tongue goes where the hitch goes."""
    behind, length = rig.c - rig.b, rig.towed_length
    heading = np.zeros(len(psi))
    for k in range(len(psi) - 1):
        lam = psi[k] - heading[k]
        half = heading[k] + STEP / 2 * (math.sin(lam) - behind * curvature[k] * math.cos(lam)) / length
        lam = psi[k] + curvature[k] * STEP / 2 - half
        heading[k + 1] = heading[k] + STEP * (math.sin(lam) - behind * curvature[k] * math.cos(lam)) / length
    return heading


def _forces(tractor: Array, implement: Array, curvature: Array, curvature_i: Array, rig: Rig) -> Array:
    """What the plan's own motion asks of the tyres, per (m/s)^2 of speed: minus mass times acceleration of
    both bodies as forces on v, r_t and r_i (rows of 3.115 to 3.117), shape (n, 3)."""

    def across(body: Array) -> Array:
        way = np.gradient(body[:, :2], STEP, axis=0)
        bend = np.gradient(way, STEP, axis=0)
        return np.asarray(-bend[:, 0] * np.sin(body[:, 2]) + bend[:, 1] * np.cos(body[:, 2]))

    force_t, force_i = rig.m_t * across(tractor), rig.m_i * across(implement)
    level = np.cos(tractor[:, 2] - implement[:, 2])
    return -np.column_stack(
        [
            force_t + force_i * level,
            rig.I_t * np.gradient(curvature, STEP) - rig.c * force_i * level,
            rig.I_i * np.gradient(curvature_i, STEP) - rig.d * force_i,
        ]
    )
