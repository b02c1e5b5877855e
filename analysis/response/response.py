"""Frequency response of a rig from a drive: measured, with 95 % bands, beside models of named parameters.

Measured and simulated outputs pass through the same windowed segments. Their difference e gives S_eu / S_uu,
what the rig's response has beyond the model's: the input's leakage between frequencies, which a window cannot
remove, is in both and cancels. The measured response is the model's plus this difference. A model that is
right leaves residuals independent of the input; their coherence then has a known distribution, whatever the
input.

Model: relaxation lengths, small motions about straight driving at the drive's mean speed. The simulation
takes the wheel angle as linear between samples, and S_eu / S_uu is added to the response of this simulation,
so that the sampling leaves no error either. The curves of the models are C (jω − A)⁻¹ B + D.

Valid up to some 10° of wheel angle, forward. Noise of the wheel sensor lowers the gain by its share of S_uu.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from tilth.analysis.response.correction import near
from tilth.analysis.response.feedback import LoopCheck, check_loop
from tilth.analysis.response.segments import (
    FEWEST,
    LENGTHS_S,
    Array,
    Complex,
    Flags,
    SegmentPlan,
    plan_segments,
    segment_spectra,
    stretches,
)
from tilth.analysis.response.simulated import model_of, residuals, sampled_response, settling
from tilth.analysis.response.spectra import Band, Transfer, band, combined_p_value, transfer
from tilth.estimator.models.linear_analysis import System, frequency_response
from tilth.estimator.models.parameters import Rig

OUTPUTS: Final = ("r_t", "r_i", "articulation")
HIGHEST_HZ: Final = 5.0  # a rig's response ends at some 1.5 Hz
OF_NYQUIST: Final = 0.8  # above, what a sensor filters and folds is seen instead of the rig
EXCITED: Final = 1e-3  # of the largest input density: less may be leakage
ABOVE_FLOOR: Final = (
    30.0  # times the input density near Nyquist's frequency: a wheel sensor's noise takes 3 %
)
STEADY_SPEED: Final = 0.1  # sd over mean: above, one response at the mean speed says little
SLOWEST: Final = 0.5  # m/s: below, a relaxation length is doubtful; in reverse the rig folds up
STILL_RAD: Final = np.radians(0.2)  # sd of a wheel angle with which nobody steers
LONG_S: Final = 12.0  # of segments: shorter ones leak where no set of parameters fits
CORRECTIONS: Final = 2  # the first weighs frequencies by a variance that holds leakage
REJECTED: Final = 0.01  # p-value below which residuals are said to follow the input


_SHORT: Final = (
    "No set of parameters fits this drive, and it is short: its bands hold the truth in 88 to 95 %."
)


@dataclass(frozen=True, slots=True)
class DriveSamples:
    """A drive on one regular clock. A NaN anywhere is a gap at that sample."""

    dt: float  # s
    wheel_angle: Array  # (n,), rad
    outputs: Mapping[str, Array]  # name of OUTPUTS → (n,), rad/s and rad
    speed: float | Array  # m/s, forward, or (n,)


@dataclass(frozen=True, slots=True)
class ModelCurve:
    """The model with one set of parameters, beside the drive."""

    name: str
    response: Complex  # (f, p), analytic, at the mean speed
    coherence: Array  # (f, p), gamma² of residual and input; NaN where the model is unstable
    p_value: Array  # (f, p), probability of so much of it if the model is right
    overall: Array  # (p,), the same over all excited frequencies
    sentence: str


@dataclass(frozen=True, slots=True)
class MeasuredResponse:
    """Response of p outputs to the wheel angle at f frequencies. Empty where `reason` says why."""

    outputs: tuple[str, ...]  # p names; yaw rates in rad/s per rad, articulation in rad per rad
    hz: Array  # (f,)
    excited: Flags  # (f,), whether the drive excites this frequency enough to look at it
    value: Complex  # (f, p), measured, corrected for leakage
    band: Band  # 95 %
    coherence: Array  # (f, p), gamma² of measured output and input
    input_density: Array  # (f,), rad²/Hz
    segments: int
    segment_s: float
    independent: float  # L, the equivalent number of segments without overlap
    speed: float  # m/s, mean
    curves: tuple[ModelCurve, ...]
    reference: str  # name of the set of parameters that leakage was corrected with
    loop: LoopCheck
    notes: tuple[str, ...]
    reason: str  # "" or why there is nothing

    @property
    def omega(self) -> Array:
        """Frequencies in rad/s, shape (f,)."""
        return 2.0 * np.pi * self.hz


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A drive with its segments and the models' residuals."""

    u: Array  # (n,)
    y: Array  # (n, p)
    dt: float
    plan: SegmentPlan
    present: Flags  # (n,), samples without a gap
    usable: Flags  # (n,), those that segments may hold
    models: Mapping[str, System]
    residuals: Mapping[str, Array]  # of stable models, (n, p), NaN where not usable
    notes: tuple[str, ...]

    def left_by(self, rig: Rig, names: tuple[str, ...]) -> Array | None:
        """Residuals of another rig, (n, p); None if its model is unstable."""
        model = model_of(rig, next(iter(self.models.values())).speed, names)
        if settling(model) is None:
            return None
        return residuals(rig, model, self.u, self.y, self.present, self.usable, self.dt)


def measured_response(
    drive: DriveSamples, rigs: Mapping[str, Rig], *, reference: str = "", automatic: bool | None = None
) -> MeasuredResponse:
    """The response of a drive beside the models of `rigs`, name → rig with its parameters.

    reference: the set that leakage is corrected with; by default the stable one whose residuals are least.
    automatic: whether a guidance system steered, where that is known. Raises ValueError for arrays that do
    not fit together or are infinite, and for an unknown output or reference.
    """
    names, u, y, speeds = _checked(drive)
    if not rigs or (reference and reference not in rigs):
        there = ", ".join(rigs) or "there are none"
        raise ValueError(f'"{reference}" is none of the sets of parameters: {there}')
    ready = _prepared(names, u, y, speeds, drive.dt, rigs, reference)
    if isinstance(ready, str):
        return _nothing(names, ready)
    return _compared(names, ready, rigs, reference, automatic)


def _prepared(
    names: tuple[str, ...],
    u: Array,
    y: Array,
    speeds: Array,
    dt: float,
    rigs: Mapping[str, Rig],
    reference: str,
) -> _Prepared | str:
    """The drive, or why nothing can be said. u, speeds: (n,), y: (n, p)."""
    present = np.isfinite(u) & np.isfinite(y).all(axis=1) & np.isfinite(speeds)
    if not present.any():
        return "There is no sample with wheel angle, speed and all outputs."
    speed = float(speeds[present].mean())
    if speed < SLOWEST:
        return f"The mean speed is {speed:.1f} m/s: forward from {SLOWEST:g} m/s is wanted."
    models = {name: model_of(rig, speed, names) for name, rig in rigs.items()}
    times = {name: time for name, model in models.items() if (time := settling(model)) is not None}
    if not times or (reference and reference not in times):
        return f"At {speed:.1f} m/s no such model is stable: none can be simulated."
    settle_s = max(times.values())
    usable = _after(present, round(settle_s / dt))
    plan = plan_segments(usable, dt)
    if plan is None:
        return _too_short(usable, dt, settle_s)
    if np.std(u[usable]) < STILL_RAD:
        return "The wheels hardly turned: there is nothing to respond to."
    left = {name: residuals(rigs[name], models[name], u, y, present, usable, dt) for name in times}
    return _Prepared(u, y, dt, plan, present, usable, models, left, _notes(speeds[usable]))


def _compared(
    names: tuple[str, ...],
    ready: _Prepared,
    rigs: Mapping[str, Rig],
    reference: str,
    automatic: bool | None,
) -> MeasuredResponse:
    plan, dt = ready.plan, ready.dt
    kept = plan.hz <= min(HIGHEST_HZ, OF_NYQUIST * 0.5 / dt)
    hz = plan.hz[kept]
    of_u = segment_spectra(ready.u[:, None], plan)[:, :, 0]
    excited = _excited(np.mean(np.abs(of_u) ** 2, axis=0), kept)
    of_u = of_u[:, kept]

    def of(values: Array) -> Transfer:
        return transfer(of_u, segment_spectra(values, plan)[:, kept], plan)

    plain = of(ready.y)
    beyond = {name: of(left) for name, left in ready.residuals.items()}
    chosen = reference or min(beyond, key=lambda name: _size(beyond[name], plain, excited))
    model, left, added = ready.models[chosen], ready.residuals[chosen], beyond[chosen]
    omega = 2.0 * np.pi * hz
    value = sampled_response(model, omega, dt) + added.value
    notes = ready.notes
    if combined_p_value(added.p_value, excited).min() < REJECTED:
        notes += (_SHORT,) if plan.length * dt < LONG_S else ()
        model, left, added = _refitted(ready, rigs[chosen], model, left, added, of, excited)
        value = sampled_response(model, omega, dt) + added.value
    return MeasuredResponse(
        outputs=names,
        hz=hz,
        excited=excited,
        value=value,
        band=band(value, added.variance, plain.freedom),
        coherence=plain.coherence,
        input_density=plain.input_density,
        segments=len(plan.starts),
        segment_s=plan.length * dt,
        independent=plan.independent,
        speed=model.speed,
        curves=tuple(
            _curve(name, model, beyond.get(name), hz, excited) for name, model in ready.models.items()
        ),
        reference=chosen,
        loop=check_loop(ready.u, left, dt, automatic=automatic),
        notes=notes,
        reason="",
    )


def _refitted(
    ready: _Prepared,
    rig: Rig,
    model: System,
    left: Array,
    added: Transfer,
    of: Callable[[Array], Transfer],
    excited: Flags,
) -> tuple[System, Array, Transfer]:
    """(model, residuals, their transfer) of parameters near the drive's, for less leakage; as given if none
    can be found."""

    def missed_by(rig: Rig) -> Complex | None:
        left = ready.left_by(rig, model.outputs)
        return None if left is None else of(left).value[excited]

    for _ in range(CORRECTIONS):
        rig = near(rig, missed_by, added.variance[excited])
        less = ready.left_by(rig, model.outputs)
        if less is None:
            break
        model, left, added = model_of(rig, model.speed, model.outputs), less, of(less)
    return model, left, added


def _excited(density: Array, kept: Flags) -> Flags:
    """Which of the kept frequencies are worth a look. density: (all,), S_uu; kept: (all,)."""
    floor = ABOVE_FLOOR * float(np.median(density[~kept][-(len(density) // 5) :])) if (~kept).any() else 0.0
    return np.asarray(density[kept] >= max(EXCITED * float(density[kept].max()), floor))


def _curve(name: str, model: System, beyond: Transfer | None, hz: Array, excited: Flags) -> ModelCurve:
    response = frequency_response(model, 2.0 * np.pi * hz)[:, :, 0]
    if beyond is None:
        unknown = np.full(response.shape, np.nan)
        sentence = f"{name}: unstable at this speed, so that it cannot be compared with the drive."
        return ModelCurve(name, response, unknown, unknown, unknown[0], sentence)
    overall = combined_p_value(beyond.p_value, excited)
    wrong = [output for output, p in zip(model.outputs, overall.tolist(), strict=True) if p < REJECTED]
    if wrong:
        sentence = (
            f"{name}: simulated over the whole drive without correction, it leaves errors of "
            f"{' and '.join(wrong)} that follow the wheel angle: a linear model with these parameters "
            "does not "
            "explain all that the steering did."
        )
    else:
        sentence = (
            f"{name}: simulated over the whole drive without correction, it leaves no error that follows the "
            "wheel angle: the drive does not contradict it."
        )
    return ModelCurve(name, response, beyond.coherence, beyond.p_value, overall, sentence)


def _size(beyond: Transfer, plain: Transfer, excited: Flags) -> float:
    """How much of the outputs' responses the model misses: mean over excited frequencies and outputs."""
    input_density = plain.input_density[excited, None]
    missed = np.sum(np.abs(beyond.value[excited]) ** 2 * input_density, axis=0)
    there = np.sum(np.abs(plain.value[excited]) ** 2 * input_density, axis=0)
    return float(np.mean(missed / np.maximum(there, np.finfo(np.float64).tiny)))


def _notes(speeds: Array) -> tuple[str, ...]:
    spread = float(speeds.std() / speeds.mean())
    if spread <= STEADY_SPEED:
        return ()
    return (f"The speed varied by {100 * spread:.0f} % (sd): one response is a mean over different ones.",)


def _after(present: Flags, settled: int) -> Flags:
    """What is left of each stretch when its first samples are left out."""
    usable = np.zeros_like(present)
    for begin, end in stretches(present):
        usable[min(begin + settled, end) : end] = True
    return usable


def _checked(drive: DriveSamples) -> tuple[tuple[str, ...], Array, Array, Array]:
    """(names, wheel angle (n,), outputs (n, p), speed (n,))."""
    u = np.asarray(drive.wheel_angle, np.float64)
    if not (np.isfinite(drive.dt) and drive.dt > 0.0):
        raise ValueError(f"samples cannot be {drive.dt} s apart")
    names = tuple(drive.outputs)
    if not names or not set(names) <= set(OUTPUTS):
        raise ValueError(f"outputs are some of {', '.join(OUTPUTS)}, not {', '.join(names) or 'none'}")
    if u.ndim != 1 or any(np.shape(values) != u.shape for values in drive.outputs.values()):
        raise ValueError("wheel angle and outputs must be as many samples, one number each")
    y = np.column_stack([np.asarray(values, np.float64) for values in drive.outputs.values()])
    if np.ndim(drive.speed) != 0 and np.shape(drive.speed) != u.shape:
        raise ValueError("the speed must be one number, or as many as wheel angles")
    speeds = np.array(np.broadcast_to(np.asarray(drive.speed, np.float64), u.shape))
    for what, values in (("wheel angle", u), ("outputs", y), ("speed", speeds)):
        if np.isinf(values).any():
            raise ValueError(f"{what}: infinite values; what was not measured must be NaN")
    return names, u, y, speeds


def _too_short(usable: Flags, dt: float, settle: float) -> str:
    longest = max((end - begin for begin, end in stretches(usable)), default=0) * dt
    wanted = (FEWEST + 1) / 2 * LENGTHS_S[-1]
    return (
        f"The drive is too short: {FEWEST} segments of {LENGTHS_S[-1]:g} s are needed, {wanted:g} s without "
        f"a gap; the longest stretch has {longest:.0f} s after the {settle:.0f} s in which the rig settles."
    )


def _nothing(names: tuple[str, ...], reason: str) -> MeasuredResponse:
    table, line = np.zeros((0, len(names))), np.zeros(0)
    untested = LoopCheck(False, None, None, "Not tested.")
    return MeasuredResponse(
        names, line, np.zeros(0, np.bool_), table.astype(np.complex128), Band(table, table, table, table),
        table, line, 0, 0.0, 0.0, float("nan"), (), "", untested, (), reason,
    )  # fmt: skip
