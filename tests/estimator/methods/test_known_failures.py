"""What went wrong for others who learned while driving, each as a drive that every estimator takes.

Sources: the issues of comma.ai's openpilot and of AgOpenGPS and its kin, by number where there is one. Every
drive is simulated traffic through the fold, at most a minute, made once and looked at by each method that may
be recommended. One that is there to compare with is never called usable: test_two_step.py.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from drives import (
    LEARNING,
    QUIET,
    SECOND,
    SEED,
    SPEED,
    Array,
    Changes,
    Run,
    driven,
    errors,
    folded,
    moved,
    sds,
    values,
)  # fmt: skip

from tilth.estimator.methods import pem
from tilth.estimator.methods.estimators import ESTIMATORS
from tilth.estimator.results.recommend import PREFERRED
from tilth.estimator.state_json import to_json_data
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Estimate, Flag, Frame, Measurement, Mount, Pose, Status
from tilth.schemas.flow import Velocity as VelocityMeasurement
from tilth.schemas.flow import YawRate as YawRateMeasurement
from tilth.simulator.scenario import Fault
from tilth.simulator.tractor import draw
from tilth.simulator.traffic import simulate

pytestmark = pytest.mark.long


METHODS = [row.method for row in ESTIMATORS if row.method in PREFERRED]
each_method = pytest.mark.parametrize("method", METHODS)


def refused(run: Run, reason: str) -> int:
    """Poses or segments that were refused, by any method or by the record builder."""
    counters: list[dict[str, int]] = [
        getattr(counter, "refused", {})
        for counter in (getattr(run.state, "record", None), *run.state.estimators.values())
    ]
    return max(sum(n for why, n in counts.items() if reason in why) for counts in counters)


def numbers(data: object) -> Iterator[float]:
    """All numbers of plain data."""
    if isinstance(data, dict):
        data = list(data.values())
    if isinstance(data, (list, tuple)):
        for item in data:
            yield from numbers(item)
    elif isinstance(data, float):
        yield data


def assert_held(run: Run, method: str, from_s: float, to_s: float) -> None:
    """Nothing was learned between two times: no number moved, no sd shrank."""
    published = [e for e in run.estimates(method) if from_s <= run.at(e.t_ns) <= to_s]
    assert len(published) >= (to_s - from_s) * 0.8
    for estimate in published[1:]:
        assert moved(published[0], estimate) < 0.02
        assert (sds(estimate) > 0.999 * sds(published[0])).all()


# Something must be learned in these drives, or nothing below could fail.


@each_method
def test_the_drives_teach(method: str) -> None:
    run = driven(QUIET, 42.0)
    published = run.last(method)
    usable = [p.status is Status.ESTIMATED for p in published.parameters]
    assert sum(usable) >= 3
    assert np.nanmax(np.abs(errors(run, published))) < 3.0


# Learning in reverse: openpilot #38573.

# After 42 s of learning a stop, then backwards with the wheels turned, then on.
REVERSING = replace(
    QUIET,
    speed=((42.0, SPEED), (5.0, 0.0), (9.0, -1.2), (4.0, 2.0)),
    steering=(*LEARNING, (4.0, -7.0), (10.0, 5.0), (4.0, 0.0)),
)


@each_method
def test_nothing_is_learned_in_reverse(method: str) -> None:
    run = driven(REVERSING, 60.0)
    backwards = [run.at(p.t_ns) for p in run.poses() if p.direction < 0]
    assert 30 <= len(backwards) <= 50
    assert 48.0 < backwards[0] < 51.0 and 54.0 < backwards[-1] < 58.0
    # A fit of what came before the stop may land 3 s after its window was closed.
    assert_held(run, method, backwards[0] + 2.0, backwards[-1])
    assert refused(run, "reverse") >= 0.9 * len(backwards) - 2


# A jump when a gate is re-entered: openpilot #33074.

# Learned, then the wheels further round than the estimators take them, and back.
TOO_FAR = replace(QUIET, steering=(*LEARNING, (9.0, 42.0), (9.0, 7.0)))


@each_method
def test_coming_back_into_the_gate_does_not_jump(method: str) -> None:
    run = driven(TOO_FAR, 60.0)
    outside = [run.at(p.t_ns) for p in run.poses() if abs(p.wheel_angle or 0.0) > math.radians(37.0)]
    assert 6.0 < outside[-1] - outside[0] < 10.0
    assert refused(run, "beyond") >= 0.9 * len(outside) - 2
    assert_held(run, method, outside[0] + 4.0, outside[-1] + 2.0)  # 4 s: a fit of what came before may land
    published = [e for e in run.estimates(method) if run.at(e.t_ns) > outside[0]]
    assert published
    for before, after in itertools.pairwise(published):
        assert moved(before, after) < (3.0 if method == pem.METHOD else 1.0)  # a fit is many samples at once
    assert refused(run, "settling") >= 10


# Bounds scaled from a light car fail above 3 t: openpilot #25389.


def scaled(factor: float) -> Changes:
    """All masses, inertias and stiffnesses so many times as large: the rig moves the same."""

    def times(number: float) -> str:
        return repr(factor * number)

    cart = "mass = {{ value = {}, sd = {} }}"
    return (
        ("mass = 9391.0", f"mass = {times(9391.0)}"),
        (cart.format("2127.0", "200.0"), cart.format(times(2127.0), times(200.0))),
        ("yaw_inertia = 35709.0", f"yaw_inertia = {times(35709.0)}"),
        ("yaw_inertia = 6402.0", f"yaw_inertia = {times(6402.0)}"),
        *((text, times(float(text))) for text in ("220e3", "486e3", "167e3")),
    )


@each_method
@pytest.mark.parametrize("factor", [0.25, 4.0])  # tractors of 2.3 t and 38 t
def test_the_weight_of_a_machine_makes_no_difference(factor: float, method: str) -> None:
    run, data = driven(QUIET, 42.0, scaled(factor)), driven(QUIET, 42.0)
    published, usual = run.last(method), data.last(method)
    assert run.truth["C_af"] == pytest.approx(factor * data.truth["C_af"])
    assert [p.status for p in published.parameters] == [p.status for p in usual.parameters]
    np.testing.assert_allclose(sds(published), sds(usual), rtol=0.15)
    shift = values(published) - values(usual) - np.log([factor] * 3 + [1.0] * 3)
    assert np.nanmax(np.abs(shift) / sds(usual)) < 0.7  # heights of the hitch and the like do not scale


# Gain and stiffness trade off at constant speed: openpilot #19672.

SURE: Changes = (("delay = 0.01", "delay = 0.01\ngain = { value = 1.0, sd = 0.0 }"),)
UNSURE: Changes = (("delay = 0.01", "delay = 0.01\ngain = { value = 1.0, sd = 0.05 }"),)


def from_data(run: Run, method: str) -> Array:
    """Covariance of the six without errors of the model, which no gain can change, nor of the file."""
    file = run.state.diagnosis.consistency.widening
    covariance = np.reshape(run.last(method).log_covariance, (6, 6)) - file.covariance
    errors = run.state.estimators[method].model_sd if method == pem.METHOD else np.zeros(6)
    return np.asarray(covariance - np.diag(errors**2), np.float64)


@each_method
def test_an_unknown_gain_of_the_wheel_angle_widens_the_stiffness(method: str) -> None:
    runs = driven(QUIET, 42.0, SURE), driven(QUIET, 42.0, UNSURE)
    sure, unsure = (run.last(method) for run in runs)
    covariances = [from_data(run, method) for run in runs]
    known, unknown = (math.sqrt(covariance[0, 0]) for covariance in covariances)
    assert unknown > 1.02 * known  # most of it is learned: what turns the implement follows the true angle
    assert sure.nuisances.get("wheel_gain", (0.0, 0.0))[1] == 0.0
    gain, sd = unsure.nuisances["wheel_gain"]
    assert abs(gain) < 3 * sd and 0.002 < sd <= 0.05
    # What the gain does to all stiffnesses alike shows in their correlation.
    correlations = [c[0, 1] / math.sqrt(c[0, 0] * c[1, 1]) for c in covariances]
    assert abs(correlations[1] - correlations[0]) > 0.005


@each_method
def test_a_gain_that_is_wrong_does_not_pass_for_stiffness(method: str) -> None:
    wrong = replace(QUIET, wheel=replace(QUIET.wheel, gain=1.04))
    run = driven(wrong, 42.0, UNSURE)
    assert np.nanmax(np.abs(errors(run, run.last(method)))) < 3.0


# A lag that changes with speed, learned slow and wrong fast: openpilot #38133.

# A relaxation length is a distance: its lag at 3 m/s is twice that at 6 m/s.
TWO_SPEEDS = replace(
    QUIET,
    speed=((30.0, 3.5), (30.0, 6.5)),
    steering=((2.0, 0.0), (10.0, 8.0), (10.0, -8.0), (10.0, 7.0), (10.0, -7.0), (10.0, 6.0), (8.0, -6.0)),
)


@each_method
def test_what_was_learned_slowly_is_right_when_driving_fast(method: str) -> None:
    run = driven(TWO_SPEEDS, 60.0)
    published = run.estimates(method)
    assert any(p.status is Status.ESTIMATED for p in published[-1].parameters)
    for estimate in published:
        found = errors(run, estimate)
        assert not np.isfinite(found).any() or np.nanmax(np.abs(found)) < 3.5
    slow = run.last(method, 30.0)
    assert moved(slow, published[-1]) < 3.0


# Three ways of zeroing a wheel-angle sensor, one with the wrong sign: AgOpenWeb #103.


SIGNS = [(0.8, 1), (-0.8, -1)]  # the zero's, and that of the sensor


@each_method
@pytest.mark.parametrize(("zero_deg", "sign"), SIGNS)
def test_a_zero_put_into_the_machine_file_takes_the_error_away(
    zero_deg: float, sign: int, method: str
) -> None:
    """The file's zero is the reading when straight after `sign`; so is what is learned beyond it."""
    learned, sd = learned_zero(zero_deg, sign, 0.0, method)
    assert learned == pytest.approx(zero_deg, abs=max(3 * sd, 0.05)) and abs(zero_deg) > 4 * sd
    error, sd = learned_zero(zero_deg, sign, zero_deg, method)
    assert abs(error) < 3 * sd and abs(error) < 0.2


@cache
def _zeroed(zero_deg: float, sign: int, in_file: float) -> Run:
    signed = {"scale = 0.01": f"scale = 0.01\nsign = {sign}"}
    zero = {"zero = { value = 0.0, sd = 0.5 }": f"zero = {{ value = {in_file!r}, sd = 0.5 }}"}
    wrong = replace(QUIET, wheel=replace(QUIET.wheel, zero_deg=zero_deg))
    frames = list(simulate(demo_machine(**signed), SEED, 38.0, wrong))
    return folded(demo_machine(**signed, **zero), frames, {})


def learned_zero(zero_deg: float, sign: int, in_file: float, method: str) -> tuple[float, float]:
    """(learned, sd), degrees, from a sensor of that zero and a machine file that has another."""
    value, sd = _zeroed(zero_deg, sign, in_file).last(method).nuisances["wheel_zero"]
    return math.degrees(value), math.degrees(sd)


# RTK float taken for fixed: AgValoniaGPS #384.

FLOATING = replace(
    QUIET,
    steering=(*LEARNING, (18.0, 6.0)),
    faults=(Fault(Mount.TRACTOR_REAR, 42.0, 54.0, "rtk_float"),),
)


@each_method
def test_a_floating_receiver_teaches_nothing(method: str) -> None:
    run = driven(FLOATING, 60.0)
    floating = [run.at(p.t_ns) for p in run.poses() if Flag.parse("floating:tractor_rear") in p.flags]
    assert 41.6 < floating[0] < 43.2 and 53.6 < floating[-1] < 55.2  # the host's clock is some 0.1 s off
    assert len(floating) == pytest.approx(5 * (floating[-1] - floating[0]), abs=2)
    # A fit that was asked for before may still land, 3 s after.
    assert_held(run, method, floating[0] + 4.0, floating[-1])
    assert refused(run, "no_rtk") >= 0.9 * len(floating) - 2
    published = [e for e in run.estimates(method) if run.at(e.t_ns) > floating[-1]]
    assert all(moved(before, after) < 1.0 for before, after in itertools.pairwise(published))


# One NaN that poisons a filter for the rest of the day.


POISON_S = (19.0, 29.0)  # in the middle of steady turns: yaw rates, then velocities
EPOCH_NS = 200_000_000


class Poisoned:
    """A decoder that gives one epoch of yaw rates and, later, one of velocities that are no numbers."""

    def __init__(self, decoder: Decoder, start_ns: int) -> None:
        self.decoder, self.rejected = decoder, decoder.rejected
        self.addresses, self.heard = decoder.addresses, decoder.heard
        self.from_ns = [start_ns + round(at * SECOND) for at in POISON_S]
        self.given = 0

    def measurements(self, frame: Frame) -> Iterator[Measurement]:
        rates, velocities = (at <= frame.t_ns < at + EPOCH_NS for at in self.from_ns)
        for measurement in self.decoder.measurements(frame):
            if rates and isinstance(measurement, YawRateMeasurement):
                self.given += 1
                yield replace(measurement, yaw_rate=math.nan)
            elif velocities and isinstance(measurement, VelocityMeasurement):
                self.given += 1
                yield replace(measurement, speed=math.inf)
            else:
                yield measurement


@cache
def poisoned() -> tuple[Run, Poisoned]:
    machine = demo_machine()
    frames = list(simulate(machine, SEED, 60.0, QUIET))
    decoder = Poisoned(Decoder(machine), frames[0].t_ns)
    return folded(machine, frames, draw(machine, SEED, QUIET), decoder), decoder


@each_method
def test_not_a_number_is_soon_forgotten(method: str) -> None:
    run, decoder = poisoned()
    assert decoder.given >= 8
    usual = driven(QUIET, 42.0).last(method)
    assert (sds(run.last(method)) < 2.0 * sds(usual)).all()  # it went on learning
    assert moved(usual, run.last(method)) < 2.0
    for estimate in run.estimates(method):
        assert np.isfinite(estimate.log_covariance).all()
        assert all(np.isfinite(pair).all() for pair in map(np.array, estimate.nuisances.values()))
    data = to_json_data(run.state.estimators[method])
    assert all(map(math.isfinite, numbers(data)))


def test_not_a_number_is_refused_and_counted() -> None:
    """No frame can say it (its fields are integers, a floating-point DBC signal is refused at the start)."""
    run, decoder = poisoned()
    assert run.state.rejected["not_a_number"] == decoder.given
    for publication in run.publications:
        if isinstance(publication.value, (Measurement, Pose)):
            assert all(map(math.isfinite, numbers(to_json_data(publication.value))))
        if publication.topic.startswith("/soil_tire"):
            assert isinstance(publication.value, Estimate)
            closed = replace(publication.value, bound=())  # a bound may be infinite, and says so
            assert all(map(math.isfinite, numbers(to_json_data(closed))))
