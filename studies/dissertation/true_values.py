"""What is true of a run on the planar plant, as the estimators' unknowns: with it a prediction shows what is
left to the ground and the sensors, which no parameters can better."""

import math

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine
from tilth.simulator.tractor import Setting

Array = NDArray[np.float64]


def true_point(machine: Machine, setting: Setting) -> Array:
    """[n] of unknowns.NAMES. What the planar plant does not have, roll modes and noise levels, stays as the
    prior has it; of what differs between a body's receivers the mean is taken."""
    point, told = unknowns.prior(machine)[0].copy(), setting.nuisances
    point[SIX] = np.log([setting.parameters[name] for name in PARAMETERS])
    point[AT["wheel_zero"]], point[AT["wheel_gain"]] = told["wheel_zero"], math.log(told["wheel_gain"])
    point[AT["curvature"]], point[AT["rolling"]] = 1.0 / setting.rig.grip_f, setting.rig.roll_f
    point[AT["parallel"]] = 0.0  # of both plants
    point[AT["two_track"]] = 0.0  # the planar plant has one slip angle an axle
    for body, letter in (("tractor", "t"), ("implement", "i")):
        point[AT[f"pair_{letter}"]] = told[f"pair_{body}"]
        point[AT[f"cg_{letter}"]] = told[f"cg_forward_{body}"]
        levers = [told[f"forward_{r.mount}"] for r in machine.receiver if r.mount.startswith(body)]
        point[AT[f"lever_{letter}"]] = np.mean(levers)
    late = [told[f"latency_{r.mount}"] - r.latency.value for r in machine.receiver]
    point[AT["latency"]] = np.mean(late)
    point[AT["m_i"]] = math.log(setting.rig.m_i / machine.implement.mass.value)
    return point
