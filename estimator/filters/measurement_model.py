"""Predicted measurements of the filters, and their Jacobians over the state and over the unknowns."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.propagation import Active
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import (
    DT,
    N_STATES,
    X_ASIDE,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_R,
    X_ROLL,
    X_SLOPE,
    X_SLOPE_RATE,
    X_SPEED,
    X_V,
    Point,
)
from tilth.estimator.filters.unknowns import (
    AT_ASIDE,
    AT_CG,
    AT_HITCH,
    AT_LEVER,
    AT_PAIR,
    AT_RATE_LATE,
    AT_ROLL_LATE,
    AT_ROLL_ZERO,
    AT_S_POSITION,
    AT_S_ROLL,
    AT_S_VELOCITY,
    AT_S_YAW_RATE,
    AT_SWAY,
)
from tilth.estimator.record.record import (
    HEADING,
    KIND,
    NORTH,
    OFFSET,
    PLACE,
    PSI,
    ROLL_ANGLE,
    VELOCITY,
    YAW_RATE,
)
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]


class Observation(NamedTuple):
    """One measurement without its value: kind, place, when it is of, and the point of linearisation."""

    kind: int  # record.YAW_RATE to ROLL_ANGLE
    place: int  # as record.PLACE
    share: float  # time since the tick before, in ticks, [0, 1); below 0 for a turn rate that is late
    u: float  # m/s
    psi_ref: float  # rad, heading of the body in `ticks` at the instant
    faster: float  # rad/s^2: how fast the turn rate that it measures grows, 0.0 of other kinds


@inner_kernel
def body_of(kind: int, place: int) -> int:
    """0 for the tractor, 1 for the implement."""
    if kind in (YAW_RATE, HEADING):
        return place
    return 0 if place < 2 else 1


@inner_kernel
def observation(
    ticks: Array, row: Array, k: int, u: float, x: Array, following: Array, unknowns: Array
) -> Observation:
    """The observation of a row of the record, at or after tick k and before the next. u: m/s. x, following:
    (30,), the state at both. unknowns: (n,)."""
    after = min(k + 1, ticks.shape[0] - 1)
    kind, place, share = int(row[KIND]), int(row[PLACE]), row[OFFSET] / DT
    psi = PSI + body_of(kind, place)
    psi_ref = ticks[k, psi] + share * (ticks[after, psi] - ticks[k, psi])
    if kind != YAW_RATE:
        return Observation(kind, place, share, u, psi_ref, 0.0)
    faster = (following[X_R + place] - x[X_R + place]) / DT
    return Observation(kind, place, share - unknowns[AT_RATE_LATE + place] / DT, u, psi_ref, faster)


@inner_kernel
def predict_measurement(x: Array, obs: Observation, point: Point, setup: RigSetup, h: Array) -> float:
    """Predicted measurement at state x, (30,); fills h, (30,) or longer, with its Jacobian."""
    h[:] = 0.0
    if obs.kind == YAW_RATE:
        h[X_R + obs.place] = 1.0
        return float(x[X_R + obs.place])
    if obs.kind == HEADING:
        h[X_PSI + obs.place] = 1.0
        return float(x[X_PSI + obs.place])
    body = body_of(obs.kind, obs.place)
    if obs.kind == ROLL_ANGLE:
        late = point.unknowns[AT_ROLL_LATE + body]
        h[X_ROLL + body], h[X_ROLL + 2 + body] = 1.0, -late
        h[X_SLOPE + body], h[X_SLOPE_RATE + body] = 1.0 / GRAVITY, -late / GRAVITY
        roll = x[X_ROLL + body] + x[X_SLOPE + body] / GRAVITY
        roll -= late * (x[X_ROLL + 2 + body] + x[X_SLOPE_RATE + body] / GRAVITY)
        return float(roll + point.unknowns[AT_ROLL_ZERO + obs.place])
    if obs.kind == VELOCITY:
        return predict_velocity(x, obs, body, point, setup, h)
    return predict_position(x, obs, body, point, setup, h)


@inner_kernel
def drawbar_height(point: Point, setup: RigSetup) -> float:
    """Of the hitch above the ground, m."""
    return setup.rig.h_h + (point.unknowns[AT_HITCH] if setup.scale == 1.0 else 0.0)


@inner_kernel
def lever_ahead(obs: Observation, body: int, point: Point, setup: RigSetup) -> float:
    """How far a receiver is ahead of its body's CG, m."""
    return float(setup.levers[obs.place, 0] + point.unknowns[AT_LEVER + body] - point.unknowns[AT_CG + body])


@inner_kernel
def from_middle(obs: Observation, body: int, setup: RigSetup) -> float:
    """How far a receiver is ahead of the middle of its body's receivers, m."""
    return float(setup.levers[obs.place, 0] - setup.middles[body, 0])


@inner_kernel
def predict_velocity(x: Array, obs: Observation, body: int, point: Point, setup: RigSetup, h: Array) -> float:
    """Of a receiver, to the right of psi_ref, m/s; fills h."""
    u, c, d = obs.u + x[X_SPEED], point.geometry[2], point.geometry[3]
    height = setup.heights[obs.place] + point.unknowns[AT_SWAY] * setup.corrected[obs.place]
    lever, drawbar = lever_ahead(obs, body, point, setup), drawbar_height(point, setup)
    angle = x[X_PSI] - obs.psi_ref
    sine, cosine = math.sin(angle), math.cos(angle)
    rate_t = x[X_ROLL + 2] + x[X_SLOPE_RATE] / GRAVITY
    rate_i = x[X_ROLL + 3] + x[X_SLOPE_RATE + 1] / GRAVITY
    h[X_V], h[X_SPEED] = cosine, sine
    up, ahead = (height, lever) if body == 0 else (drawbar, -c)
    across = x[X_V] + ahead * x[X_R] + up * rate_t
    h[X_R], h[X_ROLL + 2], h[X_SLOPE_RATE] = ahead * cosine, up * cosine, up * cosine / GRAVITY
    h[X_PSI] = u * cosine - across * sine
    value = u * sine + across * cosine
    if body == 1:
        h[X_R + 1], h[X_ROLL + 3] = lever - d, height - drawbar
        h[X_SLOPE_RATE + 1] = (height - drawbar) / GRAVITY
        value += (lever - d) * x[X_R + 1] + (height - drawbar) * rate_i
    return float(value)


@inner_kernel
def axis(kind: int, psi: float) -> tuple[float, float]:
    """(north or east) of a metre forward and of a metre to the right at heading psi, rad."""
    if kind == NORTH:
        return math.cos(psi), -math.sin(psi)
    return math.sin(psi), math.cos(psi)


@inner_kernel
def predict_position(x: Array, obs: Observation, body: int, point: Point, setup: RigSetup, h: Array) -> float:
    """North or east position of a receiver, m; fills h."""
    c, d, height = point.geometry[2], point.geometry[3], setup.heights[obs.place]
    ahead, drawbar = lever_ahead(obs, body, point, setup), drawbar_height(point, setup)
    arm, east = from_middle(obs, body, setup), 0 if obs.kind == NORTH else 1
    aside = setup.levers[obs.place, 1] + point.unknowns[AT_PAIR + body] * arm
    roll_t = x[X_ROLL] + x[X_SLOPE] / GRAVITY
    roll_i = x[X_ROLL + 1] + x[X_SLOPE + 1] / GRAVITY
    place = X_POSITION + east
    h[place] = 1.0
    forward, right = axis(obs.kind, x[X_PSI])
    ahead_t, side_t, up_t = (ahead, aside + height * roll_t, height) if body == 0 else (
        -c, drawbar * roll_t, drawbar
    )  # fmt: skip
    value = x[place] + forward * ahead_t + right * side_t
    h[X_PSI] = right * ahead_t - forward * side_t
    h[X_ROLL], h[X_SLOPE] = right * up_t, right * up_t / GRAVITY
    if body == 1:
        forward, right = axis(obs.kind, x[X_PSI + 1])
        side_i = aside + point.unknowns[AT_ASIDE] + (height - drawbar) * roll_i
        value += forward * (ahead - d) + right * side_i
        h[X_PSI + 1] = right * (ahead - d) - forward * side_i
        h[X_ROLL + 1] = right * (height - drawbar)
        h[X_SLOPE + 1] = h[X_ROLL + 1] / GRAVITY
        h[X_ASIDE + east] = 1.0
        value += x[X_ASIDE + east]
    h[X_PAIR + 2 * body + east] = arm
    return float(value + arm * x[X_PAIR + 2 * body + east])


@inner_kernel
def drawbar_slope(x: Array, obs: Observation) -> float:
    """Derivative of a measurement of the implement by the height of the drawbar."""
    if obs.kind == VELOCITY:
        rate_t = x[X_ROLL + 2] + x[X_SLOPE_RATE] / GRAVITY
        rate_i = x[X_ROLL + 3] + x[X_SLOPE_RATE + 1] / GRAVITY
        return float(rate_t * math.cos(x[X_PSI] - obs.psi_ref) - rate_i)
    roll_t = x[X_ROLL] + x[X_SLOPE] / GRAVITY
    roll_i = x[X_ROLL + 1] + x[X_SLOPE + 1] / GRAVITY
    _, right_t = axis(obs.kind, x[X_PSI])
    _, right_i = axis(obs.kind, x[X_PSI + 1])
    return float(right_t * roll_t - right_i * roll_i)


@inner_kernel
def lever_arms(x: Array, obs: Observation, body: int) -> tuple[float, float, float]:
    """Derivatives of a receiver's measurement, per metre: by its position forward, by the distance of the
    hitch behind the tractor's CG, by its position to the right."""
    if obs.kind == VELOCITY:
        cosine = math.cos(x[X_PSI] - obs.psi_ref)
        return (x[X_R] * cosine, 0.0, 0.0) if body == 0 else (x[X_R + 1], -x[X_R] * cosine, 0.0)
    sine, cosine = math.sin(x[X_PSI + body]), math.cos(x[X_PSI + body])
    if obs.kind == NORTH:
        return cosine, 0.0 if body == 0 else -math.cos(x[X_PSI]), -sine
    return sine, 0.0 if body == 0 else -math.sin(x[X_PSI]), cosine


@inner_kernel
def sway_slope(x: Array, obs: Observation, body: int, setup: RigSetup) -> float:
    """Derivative of a measured velocity by the unknown sway."""
    rate = (x[X_ROLL + 2 + body] + x[X_SLOPE_RATE + body] / GRAVITY) * setup.corrected[obs.place]
    return float(rate * math.cos(x[X_PSI] - obs.psi_ref) if body == 0 else rate)


@inner_kernel
def predict_joint_measurement(
    x: Array, obs: Observation, point: Point, active: Active, setup: RigSetup, h: Array
) -> float:
    """Predicted measurement at x, (30,); fills h, (30 + a,), with its Jacobian over the joint state."""
    value: float = predict_measurement(x, obs, point, setup, h)
    if obs.kind == HEADING:
        return value
    if obs.kind == YAW_RATE:
        for j in range(active.places.shape[0]):
            if active.places[j] == AT_RATE_LATE + obs.place:
                h[N_STATES + j] = -obs.faster
        return value
    body = body_of(obs.kind, obs.place)
    if obs.kind == ROLL_ANGLE:
        for j in range(active.places.shape[0]):
            if active.places[j] == AT_ROLL_ZERO + obs.place:
                h[N_STATES + j] = 1.0
            elif active.places[j] == AT_ROLL_LATE + body:
                h[N_STATES + j] = -x[X_ROLL + 2 + body] - x[X_SLOPE_RATE + body] / GRAVITY
        return value
    ahead, back, aside = lever_arms(x, obs, body)
    arm = from_middle(obs, body, setup)
    for j in range(active.places.shape[0]):
        place = active.places[j]
        if place == AT_LEVER + body:
            h[N_STATES + j] = ahead
        elif place == AT_CG and body == 0:
            h[N_STATES + j] = -ahead
        elif place == AT_PAIR + body:
            h[N_STATES + j] = aside * arm
        elif place == AT_ASIDE and body == 1:
            h[N_STATES + j] = aside
        elif place == AT_HITCH and body == 1 and setup.scale == 1.0:
            h[N_STATES + j] = drawbar_slope(x, obs)
        elif place == AT_SWAY:
            h[N_STATES + j] = sway_slope(x, obs, body, setup) if obs.kind == VELOCITY else 0.0
        elif body == 1 and place != AT_CG + 1:  # this one shifts hitch and receivers alike: no effect
            h[N_STATES + j] = back * active.geometry[j, 2] - ahead * active.geometry[j, 3]
    return value


@inner_kernel
def noise_factor(kind: int, unknowns: Array) -> float:
    """Factor on the stated sd of a measurement. unknowns: (n,)."""
    if kind == YAW_RATE:
        return math.exp(unknowns[AT_S_YAW_RATE])
    if kind == ROLL_ANGLE:
        return math.exp(unknowns[AT_S_ROLL])
    if kind == VELOCITY:
        return math.exp(unknowns[AT_S_VELOCITY])
    return math.exp(unknowns[AT_S_POSITION])
