"""Predicted measurements of the filters, and their Jacobians over the state and over the unknowns."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
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
    X_V,
    Point,
)
from tilth.estimator.filters.unknowns import (
    AT_ASIDE,
    AT_CG,
    AT_LEVER,
    AT_PAIR,
    AT_ROLL_LATE,
    AT_ROLL_ZERO,
    AT_S_POSITION,
    AT_S_ROLL,
    AT_S_VELOCITY,
    AT_S_YAW_RATE,
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
    """One measurement without its value: kind, place, and the point of linearisation."""

    kind: int  # record.YAW_RATE to ROLL_ANGLE
    place: int  # as record.PLACE
    share: float  # time since the tick before, in ticks, [0, 1)
    u: float  # m/s
    psi_ref: float  # rad, heading of the body in `ticks` at the instant


@kernel
def body_of(kind: int, place: int) -> int:
    """0 for the tractor, 1 for the implement."""
    if kind in (YAW_RATE, HEADING):
        return place
    return 0 if place < 2 else 1


@kernel
def observation(ticks: Array, row: Array, k: int, u: float) -> Observation:
    """The observation of a row of the record, at or after tick k and before the next. u: m/s."""
    following = min(k + 1, ticks.shape[0] - 1)
    kind, place, share = int(row[KIND]), int(row[PLACE]), row[OFFSET] / DT
    psi = PSI + body_of(kind, place)
    psi_ref = ticks[k, psi] + share * (ticks[following, psi] - ticks[k, psi])
    return Observation(kind, place, share, u, psi_ref)


@kernel
def predict_measurement(x: Array, obs: Observation, point: Point, setup: RigSetup, h: Array) -> float:
    """Predicted measurement at state x, (24,); fills h, (24,) or longer, with its Jacobian."""
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
        h[X_ROLL + body], h[X_ROLL + 2 + body], h[X_SLOPE + body] = 1.0, -late, 1.0 / GRAVITY
        roll = x[X_ROLL + body] + x[X_SLOPE + body] / GRAVITY - late * x[X_ROLL + 2 + body]
        return float(roll + point.unknowns[AT_ROLL_ZERO + obs.place])
    lever = setup.levers[obs.place, 0] + point.unknowns[AT_LEVER + body] - point.unknowns[AT_CG + body]
    if obs.kind == VELOCITY:
        return predict_velocity(x, obs, body, lever, point, setup.rig.h_h, setup.heights[obs.place], h)
    return predict_position(x, obs, body, lever, point, setup, h)


@kernel
def predict_velocity(
    x: Array,
    obs: Observation,
    body: int,
    lever: float,
    point: Point,
    drawbar: float,
    height: float,
    h: Array,
) -> float:
    """Of a receiver, to the right of psi_ref, m/s. lever: how far it is ahead of its body's CG, m."""
    u, c, d = obs.u, point.geometry[2], point.geometry[3]
    angle = x[X_PSI] - obs.psi_ref
    sine, cosine = math.sin(angle), math.cos(angle)
    h[X_V] = cosine
    if body == 0:
        h[X_R] = lever * cosine
        across = x[X_V] + x[X_R] * lever + height * x[X_ROLL + 2]
        h[X_ROLL + 2] = height * cosine
        h[X_PSI] = u * cosine - across * sine
        return float(u * sine + across * cosine)
    across = x[X_V] - c * x[X_R] + drawbar * x[X_ROLL + 2]
    h[X_ROLL + 2], h[X_ROLL + 3] = drawbar * cosine, height - drawbar
    h[X_R] = -c * cosine
    h[X_R + 1] = lever - d
    h[X_PSI] = u * cosine - across * sine
    return float(u * sine + across * cosine + (lever - d) * x[X_R + 1] + (height - drawbar) * x[X_ROLL + 3])


@kernel
def predict_position(
    x: Array, obs: Observation, body: int, lever: float, point: Point, setup: RigSetup, h: Array
) -> float:
    """North or east position of a receiver, m; fills h. lever: as of `predict_velocity`."""
    c, d = point.geometry[2], point.geometry[3]
    arm = setup.levers[obs.place, 0] - setup.middles[body, 0]
    aside = setup.levers[obs.place, 1] + (point.unknowns[AT_PAIR + body] + x[X_PAIR + body]) * arm
    if body == 1:
        aside += point.unknowns[AT_ASIDE]
    height = setup.heights[obs.place]
    aside += height * (x[X_ROLL + body] + x[X_SLOPE + body] / GRAVITY)
    psi = x[X_PSI + body]
    sine, cosine = math.sin(psi), math.cos(psi)
    sine_t, cosine_t = math.sin(x[X_PSI]), math.cos(x[X_PSI])
    ahead = lever if body == 0 else lever - d
    hitch = 0.0 if body == 0 else c
    drawbar = 0.0 if body == 0 else setup.rig.h_h
    sway_t, sway_i = drawbar * x[X_ROLL], drawbar * x[X_ROLL + 1]
    if obs.kind == NORTH:
        h[X_POSITION] = 1.0
        h[X_PSI + body] = -ahead * sine - aside * cosine
        h[X_PAIR + body] = -arm * sine
        if body == 1:
            h[X_PSI] = hitch * sine_t
        h[X_ROLL], h[X_ROLL + 1] = -drawbar * sine_t, drawbar * sine
        h[X_ROLL + body] -= height * sine
        h[X_SLOPE + body] = -height * sine / GRAVITY
        return float(
            x[X_POSITION] - hitch * cosine_t + ahead * cosine - aside * sine - sway_t * sine_t + sway_i * sine
        )
    h[X_POSITION + 1] = 1.0
    h[X_PSI + body] = ahead * cosine - aside * sine
    h[X_PAIR + body] = arm * cosine
    if body == 1:
        h[X_PSI] = -hitch * cosine_t
    h[X_ROLL], h[X_ROLL + 1] = drawbar * cosine_t, -drawbar * cosine
    h[X_ROLL + body] += height * cosine
    h[X_SLOPE + body] = height * cosine / GRAVITY
    return float(
        x[X_POSITION + 1]
        - hitch * sine_t
        + ahead * sine
        + aside * cosine
        + sway_t * cosine_t
        - sway_i * cosine
    )


@kernel
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


@kernel
def predict_joint_measurement(
    x: Array, obs: Observation, point: Point, active: Active, setup: RigSetup, h: Array
) -> float:
    """Predicted measurement at x, (24,); fills h, (24 + a,), with its Jacobian over the joint state."""
    value: float = predict_measurement(x, obs, point, setup, h)
    if obs.kind == YAW_RATE or obs.kind == HEADING:
        return value
    body = body_of(obs.kind, obs.place)
    if obs.kind == ROLL_ANGLE:
        for j in range(active.places.shape[0]):
            if active.places[j] == AT_ROLL_ZERO + obs.place:
                h[N_STATES + j] = 1.0
            elif active.places[j] == AT_ROLL_LATE + body:
                h[N_STATES + j] = -x[X_ROLL + 2 + body]
        return value
    ahead, back, aside = lever_arms(x, obs, body)
    if body == 1:
        h[X_ASIDE] = aside
        value += aside * x[X_ASIDE]
    for j in range(active.places.shape[0]):
        place = active.places[j]
        if place == AT_LEVER + body:
            h[N_STATES + j] = ahead
        elif place == AT_CG and body == 0:
            h[N_STATES + j] = -ahead
        elif place == AT_PAIR + body:
            h[N_STATES + j] = h[X_PAIR + body]
        elif place == AT_ASIDE and body == 1:
            h[N_STATES + j] = aside
        elif body == 1 and place != AT_CG + 1:  # this one shifts hitch and receivers alike: no effect
            h[N_STATES + j] = back * active.geometry[j, 2] - ahead * active.geometry[j, 3]
    return value


@kernel
def noise_factor(kind: int, unknowns: Array) -> float:
    """Factor on the stated sd of a measurement. unknowns: (n,)."""
    if kind == YAW_RATE:
        return math.exp(unknowns[AT_S_YAW_RATE])
    if kind == ROLL_ANGLE:
        return math.exp(unknowns[AT_S_ROLL])
    if kind == VELOCITY:
        return math.exp(unknowns[AT_S_VELOCITY])
    return math.exp(unknowns[AT_S_POSITION])
