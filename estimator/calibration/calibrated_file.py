"""The machine after a calibration, with the sds that the numbers have now; what was not told stays."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.calibrate import Calibration
from tilth.estimator.calibration.changes import BODY, Changes, applied
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.verdict import NOT_IDENTIFIABLE, RigVerdict
from tilth.schemas.machine import Machine, Quantity, Receiver

Array = NDArray[np.float64]

LEAST_SURVEY = 0.002  # m


def identified_changes(found: Calibration, verdict: RigVerdict) -> Changes:
    """The changes without those of numbers that the drive does not tell."""
    without = {one.number.name for one in verdict.numbers if one.status == NOT_IDENTIFIABLE}
    changes = found.changes

    def of(values: np.ndarray, *names: str) -> np.ndarray:
        return np.where([name in without for name in names], 0.0, values)

    delay = changes.delay - (np.mean(changes.delay) if "latency" in without else 0.0)
    zeros = [f"roll_zero_{mount.value}" for mount in MOUNTS]
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
        roll_zero=of(changes.roll_zero, *zeros),
    )


def calibrated_machine(machine: Machine, found: Calibration, verdict: RigVerdict) -> Machine:
    """machine: as it was read."""
    sds = {one.number.name: one.sd for one in verdict.numbers if one.status != NOT_IDENTIFIABLE}
    after = applied(machine, identified_changes(found, verdict))
    tractor, implement, wheel = after.tractor, after.implement, after.wheel_angle
    bodies = {}
    for name, body, key, suffix in (("tractor", tractor, "c", "t"), ("implement", implement, "d", "i")):
        update: dict[str, object] = {}
        if key in sds:
            length: Quantity = getattr(body, key)
            update[key] = Quantity(value=length.value, sd=sds[key])
        if name == "tractor" and "ackermann" in sds:
            update["ackermann"] = Quantity(value=tractor.ackermann.value, sd=sds["ackermann"])
        if f"pair_{suffix}" in sds:
            update["pair_yaw_sd"] = math.degrees(sds[f"pair_{suffix}"])
        if f"lever_{suffix}" in sds:
            update["lever_sd"] = sds[f"lever_{suffix}"]
        bodies[name] = body.model_copy(update=update)
    turned: dict[str, object] = {}
    if "wheel_zero" in sds:
        turned["zero"] = Quantity(value=wheel.zero.value, sd=math.degrees(sds["wheel_zero"]))
    if "wheel_gain" in sds:
        turned["gain"] = Quantity(value=wheel.gain.value, sd=wheel.gain.value * sds["wheel_gain"])
    if "wheel_curve" in sds:
        turned["curve"] = Quantity(value=wheel.curve.value, sd=sds["wheel_curve"])
    receivers = [_receiver(receiver, sds, found.delay_sd) for receiver in after.receiver]
    return after.model_copy(
        update={**bodies, "receiver": receivers, "wheel_angle": wheel.model_copy(update=turned)}
    )


def _receiver(receiver: Receiver, sds: dict[str, float], delay_sd: Array) -> Receiver:
    """delay_sd: as Calibration's; the mean of all four has some of it already."""
    update: dict[str, object] = {}
    body = BODY[MOUNTS.index(receiver.mount)]
    if "latency" in sds:
        sd = math.hypot(sds["latency"], delay_sd[body] / 2.0, delay_sd[2] / 2.0)
        update["latency"] = Quantity(value=receiver.latency.value, sd=sd)
    lateral_offset = "aside_i" if body else "aside_t"
    if lateral_offset in sds:
        update["survey_sd"] = max(sds[lateral_offset], LEAST_SURVEY)
    name = f"roll_zero_{receiver.mount.value}"
    if name in sds and receiver.roll_zero is not None:
        update["roll_zero"] = Quantity(value=receiver.roll_zero.value, sd=math.degrees(sds[name]))
    return receiver.model_copy(update=update)
