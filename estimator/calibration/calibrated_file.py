"""The machine after a calibration, with the sds that the numbers have now; what was not told stays."""

import math
from dataclasses import replace

import numpy as np

from tilth.estimator.calibration.calibrate import Calibration
from tilth.estimator.calibration.changes import BODY, LATENCIES, ROLL_ZEROS, Changes, applied
from tilth.estimator.calibration.verdict import NOT_IDENTIFIABLE, RigVerdict
from tilth.schemas.machine import Machine


def identified_changes(found: Calibration, verdict: RigVerdict) -> Changes:
    """The changes without those of numbers that the drive does not tell."""
    without = {one.number.name for one in verdict.numbers if one.status == NOT_IDENTIFIABLE}
    changes = found.changes

    def of(values: np.ndarray, *names: str) -> np.ndarray:
        return np.where([name in without for name in names], 0.0, values)

    delay = changes.delay - (np.mean(changes.delay) if "latency" in without else 0.0)
    return replace(
        changes,
        delay=delay,
        forward=of(changes.forward, "lever_t", "lever_i"),
        lateral_offset=of(changes.lateral_offset, "aside_t", "aside_i"),
        pair=of(changes.pair, "pair_t", "pair_i"),
        hitch=of(changes.hitch, "c", "d"),
        ackermann=0.0 if "ackermann" in without else changes.ackermann,
        wheel_zero=0.0 if "wheel_zero" in without else changes.wheel_zero,
        wheel_gain=1.0 if "wheel_gain" in without else changes.wheel_gain,
        linkage=changes.linkage._replace(curve=changes.linkage_before.curve)
        if "wheel_curve" in without
        else changes.linkage,
        roll_zero=of(changes.roll_zero, *ROLL_ZEROS),
    )


def calibrated_machine(machine: Machine, found: Calibration, verdict: RigVerdict) -> Machine:
    """machine: as it was read."""
    sds = {one.number.name: one.sd for one in verdict.numbers if one.status != NOT_IDENTIFIABLE}
    delay = sds.pop("latency", None)
    if delay is not None:  # the mean of all four has some of delay_sd already
        for name, body in zip(LATENCIES, BODY, strict=True):
            sds[name] = math.hypot(delay, found.delay_sd[body] / 2.0, found.delay_sd[2] / 2.0)
    return applied(machine, identified_changes(found, verdict), sds)
