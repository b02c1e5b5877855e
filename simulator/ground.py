"""The ground under the virtual tractor: its slope, what is uneven on it, and its soil over time and place.

Uneven ground is a sum of waves along the way, so that it is band-limited, can be asked for anywhere, and does
not depend on how long a run is. The implement comes over the same ground after the tractor's rear axle; a rut
pushes front, rear and implement's axle one after the other, each by its load.
A plane that falls by `slope` (rad) towards `downhill` tilts a body by its heading; horizontal and inclined
distances are not told apart (at 5° they differ by 0.4 %).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.nonlinear import STATES
from tilth.estimator.models.parameters import Rig, static_loads
from tilth.schemas.flow import PARAMETERS
from tilth.simulator.scenario import Ground, LoadChange, Soil, SoilChange

Array = NDArray[np.float64]

WAVES: Final = 24
RUT_WAVES: Final = 600  # so many that no filter can predict them: a continuous spectrum
PATCH_BAND: Final = 4.0  # longest wave of the patches over the shortest
AT: Final = {name: k for k, name in enumerate(STATES)}
AXLES: Final = ("front", "rear", "implement")
AXLE_OF: Final = [0, 1, 2, 0, 1, 2]  # of each of PARAMETERS: front, rear, implement


ROLL_WAVES: Final = 5.0
"""The planar plant's bodies follow the ground's roll as a whole: short waves would throw masses about without
any force. So waves of roll are so much longer than those of forces; on the spatial plant tyres carry both."""


class Waves(NamedTuple):
    """A band-limited function of one distance: sum of amplitude cos(wavenumber s + phase)."""

    amplitude: float
    wavenumber: Array  # rad/m, (n,)
    phase: Array  # rad, (n,)

    def at(self, s: Array | float) -> Array:
        """Its value at each s, m; the shape of s."""
        if self.amplitude == 0.0:
            return np.zeros(np.shape(s))
        angle = np.multiply.outer(s, self.wavenumber) + self.phase
        return np.asarray(self.amplitude * np.cos(angle).sum(axis=-1))


def waves(rng: np.random.Generator, sd: float, band: tuple[float, float], n: int = WAVES) -> Waves:
    """n waves of that standard deviation, their lengths (m) spread over the band by logarithm."""
    shares = (np.arange(n) + rng.random(n)) / n
    lengths = band[0] * (band[1] / band[0]) ** shares
    return Waves(sd * math.sqrt(2.0 / n), 2 * np.pi / lengths, rng.uniform(0.0, 2 * np.pi, n))


@dataclass(frozen=True, slots=True)
class Terrain:
    """How the ground tilts both bodies and pushes them. Angles rad, distances m along the tractor's way."""

    slope: float
    downhill: float
    roll: tuple[float, float]  # of tractor and implement, whatever their heading
    rolling: Waves  # rad
    lateral_force: Waves  # lateral force over weight, or over an axle's load
    lag: float  # from the tractor's rear axle to the implement's
    rut: bool = False  # whether it is each axle that it pushes

    def rolls(
        self, s: Array | float, heading_t: Array | float, heading_i: Array | float
    ) -> tuple[Array, Array]:
        """Roll of tractor and implement, right side down; shapes as of s."""
        tractor = self._roll(heading_t) + self.roll[0] + self.rolling.at(s)
        implement = self._roll(heading_i) + self.roll[1] + self.rolling.at(np.subtract(s, self.lag))
        return tractor, implement

    def pitch(self, heading: Array | float) -> Array:
        """Pitch of a body, nose up."""
        return np.asarray(-np.arcsin(np.sin(self.slope) * np.cos(self.downhill - heading)))

    def _roll(self, heading: Array | float) -> Array:
        return np.asarray(np.arcsin(np.sin(self.slope) * np.sin(self.downhill - heading)))

    def inputs(self, s: float, x: Array, rig: Rig) -> tuple[float, ...]:
        """(gravity_t, gravity_i, drive, force_t, moment_t, force_i, moment_i) of the nonlinear model at one
        state, shape (13,).

        Gravity along both bodies is one force on the tractor's drive.
        """
        psi_t, psi_i = x[AT["psi_t"]], x[AT["psi_i"]]
        roll_t, roll_i = self.rolls(s, psi_t, psi_i)
        down_t, down_i = math.cos(self.downhill - psi_t), math.cos(self.downhill - psi_i)
        along = rig.g * math.sin(self.slope) * (rig.m_t * down_t + rig.m_i * down_i)
        return rig.g * math.sin(roll_t), rig.g * math.sin(roll_i), along, *self._pushes(s, rig)

    def _pushes(self, s: float, rig: Rig) -> tuple[float, float, float, float]:
        """(force_t, moment_t, force_i, moment_i), N and N m."""
        if self.rut:
            places = s + np.array([rig.a, -rig.b, -rig.c - rig.towed_length])
            front, rear, cart = (np.array(static_loads(rig)) * self.lateral_force.at(places)).tolist()
            return front + rear, rig.a * front - rig.b * rear, cart, -rig.e * cart
        force_t = rig.m_t * rig.g * float(self.lateral_force.at(s))
        force_i = rig.m_i * rig.g * float(self.lateral_force.at(s - self.lag))
        return force_t, 0.0, force_i, 0.0


def terrain(ground: Ground, roll_deg: tuple[float, float], rig: Rig, rng: np.random.Generator) -> Terrain:
    """The ground of a scenario under a rig."""
    n, band = RUT_WAVES if ground.rut else WAVES, ground.band
    return Terrain(
        math.radians(ground.slope_deg),
        math.radians(ground.downhill_deg),
        (math.radians(roll_deg[0]), math.radians(roll_deg[1])),
        waves(rng, math.radians(ground.roll_sd_deg), (ROLL_WAVES * band[0], ROLL_WAVES * band[1]), n),
        waves(rng, ground.force_sd, band, n),
        rig.c - rig.b + rig.towed_length,
        ground.rut,
    )


@dataclass(frozen=True, slots=True)
class SoilField:
    """The six soil-tyre parameters over time and place."""

    theta: Array  # (6,), without changes and patches
    changes: tuple[SoilChange, ...]
    patches: tuple[tuple[Waves, Array], ...]  # of all axles, and of each besides; along vectors (WAVES, 2)
    rig: Rig
    loads: tuple[LoadChange, ...] = ()

    @property
    def uniform(self) -> bool:
        return not self.changes and not self.patches and not self.loads

    def rig_at(self, t: float) -> Rig:
        """With what the implement carries then, s."""
        rig = self.rig
        for change in self.loads:
            factor = 1.0 + float(_begun(change, t)) * (change.mass - 1.0)
            rig = rig._replace(m_i=rig.m_i * factor, I_i=rig.I_i * factor)
        return rig

    def by_load(self, t: Array | float) -> Array:
        """Added to the logarithms of PARAMETERS by what the implement carries, shape (..., 6)."""
        log, before = np.zeros((*np.shape(t), len(PARAMETERS))), self.rig
        for change in self.loads:
            after = before._replace(m_i=before.m_i * change.mass)
            grown = np.log(np.divide(static_loads(after), static_loads(before)))
            log[..., :3] += change.exponent * np.multiply.outer(_begun(change, t), grown)
            before = after
        return log

    def at(self, t: Array | float, states: Array) -> Array:
        """Parameters under the axles, shape (..., 6). t: s, shape (...); states: (..., 13)."""
        axles = axles_of(self.rig, states)
        log = np.zeros((*axles.shape[:-2], len(PARAMETERS))) + self.by_load(t)
        for change in self.changes:
            factors = np.log([getattr(change, name) for name in PARAMETERS])
            log += share(change, t, axles)[..., AXLE_OF] * factors
        for k, (wave, direction) in enumerate(self.patches):
            felt = slice(0, 3) if k == 0 else slice(k - 1, k)
            angle = (axles[..., felt, :] @ direction.T) * wave.wavenumber + wave.phase
            log[..., felt] += wave.amplitude * np.cos(angle).sum(axis=-1)
        return np.asarray(self.theta * np.exp(log))


def _begun(change: LoadChange, t: Array | float) -> Array:
    """How much of a change there is, 0 to 1, shape of t, s."""
    since = np.subtract(t, change.at_s)
    return (
        np.asarray(since >= 0.0, np.float64) if change.over == 0.0 else np.clip(since / change.over, 0.0, 1.0)
    )


def axles_of(rig: Rig, states: Array) -> Array:
    """North and east of the middles of front, rear and implement's axle, m, shape (..., 3, 2). states:
    (..., 13)."""
    psi_t, psi_i = states[..., AT["psi_t"]], states[..., AT["psi_i"]]
    centre = states[..., :2]
    ahead_t = np.stack([np.cos(psi_t), np.sin(psi_t)], axis=-1)
    ahead_i = np.stack([np.cos(psi_i), np.sin(psi_i)], axis=-1)
    cart = centre - rig.c * ahead_t - rig.towed_length * ahead_i
    return np.stack([centre + rig.a * ahead_t, centre - rig.b * ahead_t, cart], axis=-2)


def share(change: SoilChange, t: Array | float, axles: Array) -> Array:
    """How much of a change there is at each axle, 0 to 1, shape (..., 3). axles: (..., 3, 2)."""
    if change.at_s is not None:
        beyond = np.broadcast_to(np.subtract(t, change.at_s)[..., None], axles.shape[:-1])
    else:
        towards = math.radians(change.towards_deg)
        beyond = (axles[..., 0] - (change.north or 0.0)) * math.cos(towards)
        beyond = beyond + (axles[..., 1] - (change.east or 0.0)) * math.sin(towards)
    if change.over == 0.0:
        return np.where(beyond >= 0.0, 1.0, 0.0)
    return np.asarray(np.clip(beyond / change.over, 0.0, 1.0))


def field(
    soil: Soil, parameters: Mapping[str, float], rig: Rig, rng: np.random.Generator,
    loads: tuple[LoadChange, ...] = (),
) -> SoilField:  # fmt: skip
    """The soil of a scenario; `parameters`: the six before any change."""
    patches = []
    if soil.patch_log_sd > 0.0:
        band, own = (soil.patch_length, PATCH_BAND * soil.patch_length), math.sqrt(1.0 - soil.patch_common)
        for part in (math.sqrt(soil.patch_common), *(own,) * (len(AXLES) if own else 0)):
            wave, angle = waves(rng, part * soil.patch_log_sd, band), rng.uniform(0.0, np.pi, WAVES)
            patches.append((wave, np.column_stack([np.cos(angle), np.sin(angle) / soil.patch_across])))
    theta = np.array([parameters[name] for name in PARAMETERS])
    return SoilField(theta, soil.changes, tuple(patches), rig, loads)


def crossings(
    changes: tuple[SoilChange, ...], rig: Rig, time: Array, states: Array
) -> Iterator[tuple[int, str, float, float]]:
    """(number of the change from 1, axle, when it begins there, when it is whole), s, for those that come.

    time: (n,), states: (n, 13).
    """
    axles = axles_of(rig, states)
    for number, change in enumerate(changes, start=1):
        for axle, part in zip(AXLES, share(change, time, axles).T, strict=True):
            begun = np.flatnonzero(part > 0.0)
            if len(begun):
                whole = np.flatnonzero(part >= 1.0)
                until = time[whole[0]] if len(whole) else time[-1]
                yield number, axle, float(time[begun[0]]), float(until)
