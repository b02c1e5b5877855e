"""What the filters expect of each sensor with its slopes, written by `deploy.generate`.

Change deploy/observation_equations.py instead.
"""

from math import cos, exp, sin

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.observation import Observation

Array = NDArray[np.float64]

WHEEL_ANGLE_UNKNOWNS = (6, 7, 8)  # that act on the true wheel angle


@inner_kernel
def yaw_rate(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    c0 = 1 * body
    r = x[1 + c0]
    q_rate_late = q[36 + c0]
    faster = obs.faster
    taken_ago = q[36 + body]
    value = faster * (-q_rate_late + taken_ago) + r
    slopes[1 + c0] = 1
    slopes[66 + c0] = -faster
    return float(value)


@inner_kernel
def heading(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    psi = x[10 + 1 * body]
    value = psi
    slopes[10 + 1 * body] = 1
    return float(value)


@inner_kernel
def measured_roll(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    c0 = 1 * body
    phi = x[6 + c0]
    p = x[8 + c0]
    bank = x[15 + c0]
    bank_rate = x[19 + c0]
    q_roll_late = q[34 + c0]
    q_roll_zero = q[30 + obs.place]
    g = setup.rig.g
    t0 = 1.0 / g
    t1 = bank_rate * t0 + p
    value = bank * t0 + phi - q_roll_late * t1 + q_roll_zero
    slopes[6 + c0] = 1
    slopes[8 + c0] = -q_roll_late
    slopes[15 + c0] = t0
    slopes[19 + c0] = -q_roll_late * t0
    slopes[64 + c0] = -t1
    slopes[60 + obs.place] = 1
    return float(value)


@inner_kernel
def north_t(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    phi_t = x[6]
    psi_t = x[10]
    bank_t = x[15]
    north = x[22]
    pair_t_north = x[24]
    q_pair_t = q[9]
    q_lever_t = q[11]
    q_cg_t = q[14]
    ahead = setup.levers[obs.place, 0]
    right = setup.levers[obs.place, 1]
    middle = setup.middles[body, 0]
    height = setup.heights[obs.place]
    g = setup.rig.g
    t0 = ahead - middle
    t1 = cos(psi_t)
    t2 = ahead - q_cg_t + q_lever_t
    t3 = sin(psi_t)
    t4 = 1.0 / g
    t5 = height * (bank_t * t4 + phi_t) + q_pair_t * t0 + right
    t6 = height * t3
    value = north + pair_t_north * t0 + t1 * t2 - t3 * t5
    slopes[6] = -t6
    slopes[10] = -t1 * t5 - t2 * t3
    slopes[15] = -t4 * t6
    slopes[22] = 1
    slopes[24] = t0
    slopes[39] = -t0 * t3
    slopes[41] = t1
    slopes[44] = -t1
    return float(value)


@inner_kernel
def north_i(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    phi_t = x[6]
    phi_i = x[7]
    psi_t = x[10]
    psi_i = x[11]
    bank_t = x[15]
    bank_i = x[16]
    north = x[22]
    pair_i_north = x[26]
    offset_north = x[28]
    q_pair_i = q[10]
    q_lever_i = q[12]
    q_aside_i = q[13]
    q_cg_t = q[14]
    q_roll_hitch = q[25]
    q_c = q[53]
    q_d = q[54]
    ahead = setup.levers[obs.place, 0]
    right = setup.levers[obs.place, 1]
    middle = setup.middles[body, 0]
    height = setup.heights[obs.place]
    c = setup.geometry[2]
    d = setup.geometry[3]
    h_h = setup.rig.h_h
    g = setup.rig.g
    rolls = 1.0 if setup.scale == 1.0 else 0.0
    t0 = ahead - middle
    t1 = cos(psi_i)
    t2 = d * exp(q_d)
    t3 = ahead + q_lever_i - t2
    t4 = cos(psi_t)
    t5 = c * exp(q_c)
    t6 = -q_cg_t - t5
    t7 = 1.0 / g
    t8 = bank_t * t7 + phi_t
    t9 = sin(psi_t)
    t10 = h_h + q_roll_hitch * rolls
    t11 = t10 * t9
    t12 = sin(psi_i)
    t13 = bank_i * t7 + phi_i
    t14 = height - t10
    t15 = q_aside_i + q_pair_i * t0 + right + t13 * t14
    t16 = t12 * t14
    value = north + offset_north + pair_i_north * t0 + t1 * t3 - t11 * t8 - t12 * t15 + t4 * t6
    slopes[6] = -t11
    slopes[7] = -t16
    slopes[10] = -t10 * t4 * t8 - t6 * t9
    slopes[11] = -t1 * t15 - t12 * t3
    slopes[15] = -t11 * t7
    slopes[16] = -t16 * t7
    slopes[22] = 1
    slopes[26] = t0
    slopes[28] = 1
    slopes[40] = -t0 * t12
    slopes[42] = t1
    slopes[43] = -t12
    slopes[44] = -t4
    slopes[55] = rolls * t12 * t13 - rolls * t8 * t9
    slopes[83] = -t4 * t5
    slopes[84] = -t1 * t2
    return float(value)


@inner_kernel
def east_t(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    phi_t = x[6]
    psi_t = x[10]
    bank_t = x[15]
    east = x[23]
    pair_t_east = x[25]
    q_pair_t = q[9]
    q_lever_t = q[11]
    q_cg_t = q[14]
    ahead = setup.levers[obs.place, 0]
    right = setup.levers[obs.place, 1]
    middle = setup.middles[body, 0]
    height = setup.heights[obs.place]
    g = setup.rig.g
    t0 = ahead - middle
    t1 = sin(psi_t)
    t2 = ahead - q_cg_t + q_lever_t
    t3 = cos(psi_t)
    t4 = 1.0 / g
    t5 = height * (bank_t * t4 + phi_t) + q_pair_t * t0 + right
    t6 = height * t3
    value = east + pair_t_east * t0 + t1 * t2 + t3 * t5
    slopes[6] = t6
    slopes[10] = -t1 * t5 + t2 * t3
    slopes[15] = t4 * t6
    slopes[23] = 1
    slopes[25] = t0
    slopes[39] = t0 * t3
    slopes[41] = t1
    slopes[44] = -t1
    return float(value)


@inner_kernel
def east_i(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    phi_t = x[6]
    phi_i = x[7]
    psi_t = x[10]
    psi_i = x[11]
    bank_t = x[15]
    bank_i = x[16]
    east = x[23]
    pair_i_east = x[27]
    offset_east = x[29]
    q_pair_i = q[10]
    q_lever_i = q[12]
    q_aside_i = q[13]
    q_cg_t = q[14]
    q_roll_hitch = q[25]
    q_c = q[53]
    q_d = q[54]
    ahead = setup.levers[obs.place, 0]
    right = setup.levers[obs.place, 1]
    middle = setup.middles[body, 0]
    height = setup.heights[obs.place]
    c = setup.geometry[2]
    d = setup.geometry[3]
    h_h = setup.rig.h_h
    g = setup.rig.g
    rolls = 1.0 if setup.scale == 1.0 else 0.0
    t0 = ahead - middle
    t1 = sin(psi_i)
    t2 = d * exp(q_d)
    t3 = ahead + q_lever_i - t2
    t4 = sin(psi_t)
    t5 = c * exp(q_c)
    t6 = -q_cg_t - t5
    t7 = 1.0 / g
    t8 = bank_t * t7 + phi_t
    t9 = cos(psi_t)
    t10 = h_h + q_roll_hitch * rolls
    t11 = t10 * t9
    t12 = cos(psi_i)
    t13 = bank_i * t7 + phi_i
    t14 = height - t10
    t15 = q_aside_i + q_pair_i * t0 + right + t13 * t14
    t16 = t12 * t14
    value = east + offset_east + pair_i_east * t0 + t1 * t3 + t11 * t8 + t12 * t15 + t4 * t6
    slopes[6] = t11
    slopes[7] = t16
    slopes[10] = -t10 * t4 * t8 + t6 * t9
    slopes[11] = -t1 * t15 + t12 * t3
    slopes[15] = t11 * t7
    slopes[16] = t16 * t7
    slopes[23] = 1
    slopes[27] = t0
    slopes[29] = 1
    slopes[40] = t0 * t12
    slopes[42] = t1
    slopes[43] = t12
    slopes[44] = -t4
    slopes[55] = -rolls * t12 * t13 + rolls * t8 * t9
    slopes[83] = -t4 * t5
    slopes[84] = -t1 * t2
    return float(value)


@inner_kernel
def velocity_t(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    v = x[0]
    r_t = x[1]
    p_t = x[8]
    psi_t = x[10]
    bank_rate_t = x[19]
    speed = x[21]
    q_lever_t = q[11]
    q_cg_t = q[14]
    q_sway = q[38]
    u = obs.u
    psi_ref = obs.psi_ref
    ahead = setup.levers[obs.place, 0]
    height = setup.heights[obs.place]
    corrected = setup.corrected[obs.place]
    g = setup.rig.g
    t0 = speed + u
    t1 = psi_ref - psi_t
    t2 = sin(t1)
    t3 = cos(t1)
    t4 = ahead - q_cg_t + q_lever_t
    t5 = corrected * q_sway + height
    t6 = 1.0 / g
    t7 = bank_rate_t * t6 + p_t
    t8 = r_t * t4 + t5 * t7 + v
    t9 = t3 * t5
    t10 = r_t * t3
    value = -t0 * t2 + t3 * t8
    slopes[0] = t3
    slopes[1] = t3 * t4
    slopes[8] = t9
    slopes[10] = t0 * t3 + t2 * t8
    slopes[19] = t6 * t9
    slopes[21] = -t2
    slopes[41] = t10
    slopes[44] = -t10
    slopes[68] = corrected * t3 * t7
    return float(value)


@inner_kernel
def velocity_i(x: Array, q: Array, body: int, obs: Observation, setup: RigSetup, slopes: Array) -> float:
    """Its value; fills the slopes (30 + n,) by states and unknowns that are not zero."""
    v = x[0]
    r_t = x[1]
    r_i = x[2]
    p_t = x[8]
    p_i = x[9]
    psi_t = x[10]
    bank_rate_t = x[19]
    bank_rate_i = x[20]
    speed = x[21]
    q_lever_i = q[12]
    q_cg_t = q[14]
    q_roll_hitch = q[25]
    q_sway = q[38]
    q_c = q[53]
    q_d = q[54]
    u = obs.u
    psi_ref = obs.psi_ref
    ahead = setup.levers[obs.place, 0]
    height = setup.heights[obs.place]
    corrected = setup.corrected[obs.place]
    c = setup.geometry[2]
    d = setup.geometry[3]
    h_h = setup.rig.h_h
    g = setup.rig.g
    rolls = 1.0 if setup.scale == 1.0 else 0.0
    t0 = d * exp(q_d)
    t1 = ahead + q_lever_i - t0
    t2 = speed + u
    t3 = psi_ref - psi_t
    t4 = sin(t3)
    t5 = 1.0 / g
    t6 = bank_rate_i * t5 + p_i
    t7 = q_roll_hitch * rolls
    t8 = corrected * q_sway - h_h + height - t7
    t9 = cos(t3)
    t10 = c * exp(q_c)
    t11 = -q_cg_t - t10
    t12 = h_h + t7
    t13 = bank_rate_t * t5 + p_t
    t14 = r_t * t11 + t12 * t13 + v
    t15 = t12 * t9
    t16 = r_t * t9
    value = r_i * t1 + t14 * t9 - t2 * t4 + t6 * t8
    slopes[0] = t9
    slopes[1] = t11 * t9
    slopes[2] = t1
    slopes[8] = t15
    slopes[9] = t8
    slopes[10] = t14 * t4 + t2 * t9
    slopes[19] = t15 * t5
    slopes[20] = t5 * t8
    slopes[21] = -t4
    slopes[42] = r_i
    slopes[44] = -t16
    slopes[55] = rolls * t13 * t9 - rolls * t6
    slopes[68] = corrected * t6
    slopes[83] = -t10 * t16
    slopes[84] = -r_i * t0
    return float(value)


@inner_kernel
def wheel_angle(reading: float, reading_rate: float, q: Array) -> float:
    """Value of the true wheel angle, rad."""
    q_wheel_zero = q[6]
    q_wheel_gain = q[7]
    q_latency = q[8]
    reading_ago = q[8]
    value = (-q_wheel_zero + reading + reading_rate * (-q_latency + reading_ago)) * exp(-q_wheel_gain)
    return float(value)


@inner_kernel
def wheel_angle_slopes(reading: float, reading_rate: float, q: Array, slopes: Array) -> None:
    """Fill the slopes (n,) of it by unknowns that are not zero."""
    q_wheel_zero = q[6]
    q_wheel_gain = q[7]
    q_latency = q[8]
    reading_ago = q[8]
    t0 = exp(-q_wheel_gain)
    slopes[6] = -t0
    slopes[7] = -t0 * (-q_wheel_zero + reading + reading_rate * (-q_latency + reading_ago))
    slopes[8] = -reading_rate * t0
