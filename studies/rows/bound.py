"""How well a simulated row can tell the six parameters, whatever the ground does: a bound, at the truth.

Nothing of the product's filter is in it. The rolling model (estimator/models/rolling.py), linearised about
straight running at the true rig and speed, gives what each unknown changes in the readings along the true
wheel angle (S), and a Kalman filter of its own, with a rough ground, whitens both. The innovations that are
left at the truth are regressed on their own past (filters/free_noise.py); what the past cannot explain of the
slopes is information. Unknowns beside the six, and what is known of them and of the six before, are those of
the machine file (estimator/filters/unknowns.py).

Valid for a row that runs north, from its start on, on one soil.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_triangular

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.free_noise import gradient_and_information, lagged, regress
from tilth.estimator.filters.unknowns import UNKNOWNS, ActsAs
from tilth.estimator.models.roll_stiffness import nominal_roll
from tilth.estimator.models.rolling import empty_motion, rates
from tilth.estimator.models.rolling_terms import CONSTANTS, INPUTS, PARAMETERS, STATES
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine, Receiver
from tilth.simulator.receivers import FIRST_EPOCH_S, plane, reports
from tilth.simulator.scenario import STEP_S
from tilth.simulator.tractor import Truth

Array = NDArray[np.float64]

DT: Final = 0.02  # s, of the model
EPOCH_S: Final = 0.2
TICKS: Final = round(EPOCH_S / DT)
PAST: Final = 1.2  # reach of the past, over the way from the front to the last axle
ORDERS: Final = (10, 25)  # epochs of the past, least and most
SPREADS: Final = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
"""Of the coefficients of the past, of which the likeliest is taken: a bound must not assume how smooth the
ground is."""
SETTLING_S: Final = 10.0  # in which the filter only finds its state
Y: Final = len(STATES)  # place of the CG's way across the row, after the model's states
N_MOTION: Final = Y + 1
STIFF: Final = 30.0  # the planar plant's rig does not roll: so many times the usual roll stiffness
SMALL: Final = 1e-5  # step of differences by states and inputs
STEP: Final = 0.05  # of the prior's sd: step of differences by unknowns

# Of the filter that whitens. That it is rough does not matter: its innovations are regressed on their past.
PUSHES: Final = (("v", 0.05), ("r_t", 0.02), ("r_i", 0.03))  # m/s^2 and rad/s^2 of the ground
UNEVEN: Final = 0.01  # rad
GROUND_M: Final = 2.0  # of way, over which both last
SLOW: Final = ((0.015, 100.0), *((0.007, 20.0),) * 4)  # m and s of errors: shared, of each antenna's own
WHITE: Final = np.array([*[0.009] * 4, 0.022, 0.022, 0.0023, 0.0023])  # sds of the outputs; m, m/s, rad/s
FIRST_SD: Final = np.array([0.1, 0.05, 0.05, 0.02, 0.02, 0.02, 0.03, 0.03, 0.05, 0.05, 0.02, 0.02, 0.3])

OUTPUTS: Final = 8
"""East of each antenna (tractor's front and rear, implement's), the mean of both receivers of either body of
its velocity east, and of its yaw rate."""


@dataclass(frozen=True, slots=True)
class TruePoint:
    """What a row's readings follow from."""

    motion: Mapping[str, float]  # of PARAMETERS and CONSTANTS
    levers: tuple[float, ...]  # m, of the antennas ahead of their CG
    heights: tuple[float, ...]  # m above the ground; 0 where a receiver corrects for roll
    gain: float = 0.0  # logarithm
    zero: float = 0.0  # rad
    latency: float = 0.0  # s
    pairs: tuple[float, float] = (0.0, 0.0)  # rad
    aside: float = 0.0  # m
    rate_late: tuple[float, float] = (0.0, 0.0)  # s


@dataclass(frozen=True, slots=True)
class RowBound:
    """Of one row."""

    sd: Array  # (6,), of the logarithms, with what is known before
    step: Array  # (6,), one Newton step from the truth, logarithms: as large as sd where all is as modelled
    unexplained: float  # 1 - R^2 of the wheel angle on past innovations, adjusted
    wheel_rms: float  # rad
    spread: float  # of the coefficients of the past, the likeliest
    told: Array  # (a, a), information of the row alone, of the six and whatever else it depends on
    known: Array  # (a,), sds of what is known of them before


def together(bounds: Sequence[RowBound]) -> Array:
    """Of several rows of one rig, (6,)."""
    told = np.sum([each.told for each in bounds], axis=0) + np.diag(bounds[0].known ** -2)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(told))[:6]))


def likeliest_spread(stretches: Sequence[Array], order: int, spreads: Sequence[float]) -> float:
    """Of some spreads the one under which innovations are likeliest, with coefficients and covariance of w
    integrated and maximised out: smooth ground needs large coefficients that cancel, white noise none.

    stretches: as of free_noise.regress.
    """
    past, now = lagged(stretches, order), np.concatenate([e[order:] for e in stretches])
    gram, across, total, outputs = past.T @ past, past.T @ now, now.T @ now, now.shape[1]

    def cost(spread: float) -> float:
        prior = np.repeat((np.arange(1, order + 1) / spread) ** 2, outputs)
        root = np.linalg.cholesky(gram + np.diag(prior))
        seen = solve_triangular(root, across, lower=True, check_finite=False)
        _, left = np.linalg.slogdet(total - seen.T @ seen)
        determinant = 2.0 * float(np.sum(np.log(np.diag(root)))) - float(np.sum(np.log(prior)))
        return float(outputs * determinant + len(now) * left)

    return min(spreads, key=cost)


def in_order(machine: Machine) -> list[Receiver]:
    """Tractor's front and rear receiver, implement's. Raises ValueError where one is missing."""
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    if missing := [mount for mount in Mount if mount not in by_mount]:
        raise ValueError(f"a bound needs all four receivers; there is none at {', '.join(missing)}")
    return [by_mount[mount] for mount in Mount]


def true_point(machine: Machine, truth: Truth) -> TruePoint:
    """The rig as it is."""
    rig, told = truth.rig, truth.nuisances
    roll = nominal_roll(machine)._asdict()
    motion = {
        **rig._asdict(),
        **roll,
        "camber": 0.0,
        "parallel": 0.0,
        "slip_dependence": 0.5,
        "two_track": 1.0,
    }
    motion |= {f"{k}_{axle}": truth.parameters[f"{long}{axle}"]
               for k, long in (("C", "C_a"), ("sigma", "sigma_")) for axle in "fri"}  # fmt: skip
    motion |= {"exponent": rig.load_exponent, "rolling": rig.roll_r, "curvature": 1.0 / rig.grip_r}
    if truth.space is None:
        motion |= {name: STIFF * roll[name] for name in ("k_t", "k_i", "k_f")}
    else:
        made, on_front = truth.space.vehicle, rig.b / (rig.a + rig.b)  # which leans about its pin
        by_axle = [(k * w**2 / 2, d * w**2 / 2)
                   for k, d, w in zip(made.stiffness, made.damping, made.track, strict=True)]  # fmt: skip
        motion |= {
            "k_f": by_axle[0][0],
            "k_t": by_axle[1][0] - rig.m_t * rig.g * (rig.h_t - on_front * made.pin_height),
            "k_i": by_axle[2][0] - rig.m_i * rig.g * rig.h_i,
            "d_t": by_axle[1][1],
            "d_i": by_axle[2][1],
            "j_t": rig.m_t * made.roll_gyration[0] ** 2,
            "j_i": rig.m_i * made.roll_gyration[1] ** 2,
            "pivot_height": made.pin_height,
            "camber": made.camber_thrust,
            "parallel": 1.0 - made.ackermann,
        }
    receivers = in_order(machine)
    body = [r.mount.body for r in receivers]
    levers = [
        r.position[0] + told[f"forward_{r.mount}"] - told[f"cg_forward_{of}"]
        for r, of in zip(receivers, body, strict=True)
    ]
    heights = [0.0 if r.roll_corrected else r.position[2] for r in receivers]
    pairs = told["pair_tractor"], told["pair_implement"]
    return TruePoint(motion, tuple(levers), tuple(heights), pairs=pairs)


def moved(point: TruePoint, unknown: unknowns.Unknown, by: float) -> TruePoint | None:
    """The point with one of the unknowns changed; None for one that moves nothing here."""
    if unknown.transform is not ActsAs.NONE:
        motion = dict(point.motion)
        for name in unknown.acts_on.split():
            sign, key = (-1.0 if name.startswith("-") else 1.0), name.lstrip("-")
            motion[key] = (
                motion[key] * np.exp(by) if unknown.transform is ActsAs.FACTOR else motion[key] + sign * by
            )
        ahead = {"cg_t": 0, "cg_i": 2}.get(unknown.name)
        shift = [-by if ahead is not None and k // 2 == ahead // 2 else 0.0 for k in range(4)]
        levers = tuple(lever + more for lever, more in zip(point.levers, shift, strict=True))
        return replace(point, motion=motion, levers=levers)
    first, second = point.pairs
    late_t, late_i = point.rate_late
    lever = point.levers
    changed = {
        "wheel_zero": {"zero": point.zero + by},
        "wheel_gain": {"gain": point.gain + by},
        "latency": {"latency": point.latency + by},
        "pair_t": {"pairs": (first + by, second)},
        "pair_i": {"pairs": (first, second + by)},
        "lever_t": {"levers": (lever[0] + by, lever[1] + by, *lever[2:])},
        "lever_i": {"levers": (*lever[:2], lever[2] + by, lever[3] + by)},
        "aside_i": {"aside": point.aside + by},
        "rate_late_t": {"rate_late": (late_t + by, late_i)},
        "rate_late_i": {"rate_late": (late_t, late_i + by)},
    }.get(unknown.name)
    return None if changed is None else replace(point, **changed)  # type: ignore[arg-type]


# The linear model.


def linearised(motion: Mapping[str, float], u: float) -> tuple[Array, Array]:
    """(by states (13, 13), by wheel angle and unevenness of either body (13, 3)) about straight running."""
    p = np.array([motion[name] for name in (*PARAMETERS, *CONSTANTS)])
    at = empty_motion()
    columns = [INPUTS.index(name) for name in ("delta", "uneven_t", "uneven_i")]

    def slope(x: Array, w: Array) -> Array:
        both = []
        for sign in (SMALL, -SMALL):
            out, inputs = np.zeros(Y), sign * w
            inputs[INPUTS.index("u")] = u
            rates(sign * x, inputs, p, at, out)
            both.append(out)
        return np.asarray((both[0] - both[1]) / (2 * SMALL))

    A, B = np.zeros((N_MOTION, N_MOTION)), np.zeros((N_MOTION, 3))
    no_x, no_w = np.zeros(Y), np.zeros(len(INPUTS))
    A[:Y, :Y] = np.stack([slope(row, no_w) for row in np.eye(Y)], axis=1)
    B[:Y] = np.stack([slope(no_x, np.eye(len(INPUTS))[k]) for k in columns], axis=1)
    A[Y, STATES.index("v")], A[Y, STATES.index("psi_t")] = 1.0, u
    return A, B


def readings_of(point: TruePoint, u: float) -> Array:
    """OUTPUTS by states, (8, 13)."""
    m, H = point.motion, np.zeros((OUTPUTS, N_MOTION))

    def put(row: int, **of: float) -> None:
        for name, value in of.items():
            H[row, Y if name == "y" else STATES.index(name)] += value

    for k, (lever, height) in enumerate(zip(point.levers, point.heights, strict=True)):
        if k < 2:
            put(k, y=1.0, psi_t=lever, phi_t=height)
            put(4, v=0.5, psi_t=u / 2, r_t=lever / 2, p_t=height / 2)
            continue
        behind, above = lever - m["d"], height - m["h_h"]
        put(k, y=1.0, psi_t=-m["c"], psi_i=behind, phi_t=m["h_h"], phi_i=above)
        put(5, v=0.5, psi_t=u / 2, r_t=-m["c"] / 2, r_i=behind / 2, p_t=m["h_h"] / 2, p_i=above / 2)
    put(6, r_t=1.0)
    put(7, r_i=1.0)
    return H


def response(points: Sequence[TruePoint], u: float, wheel_angle: Array, epochs: NDArray[np.int64]) -> Array:
    """What steering makes of the outputs at each point, (n, 8, m). wheel_angle: rad, DT apart; epochs: (n,),
    samples of it."""
    ticks = []
    for point in points:
        A, B = linearised(point.motion, u)
        rows = np.zeros((N_MOTION + 1, N_MOTION + 1))
        rows[:N_MOTION, :N_MOTION], rows[:N_MOTION, N_MOTION] = A, B[:, 0]
        ticks.append(expm(rows * DT)[:N_MOTION])
    tick, at = np.array(ticks), np.arange(len(wheel_angle), dtype=np.float64)
    driven = np.stack([
        (np.interp(at - point.latency / DT, at, wheel_angle) - point.zero) * np.exp(-point.gain)
        for point in points
    ], axis=1)  # fmt: skip
    between = (driven[1:] + driven[:-1]) / 2
    x = np.zeros((len(driven), len(points), N_MOTION))
    for k, angle in enumerate(between):
        x[k + 1] = (tick[:, :, :N_MOTION] @ x[k, :, :, None])[:, :, 0] + tick[:, :, N_MOTION] * angle[:, None]
    return np.stack([_read(point, u, x[:, k], epochs) for k, point in enumerate(points)], axis=2)


def _read(point: TruePoint, u: float, x: Array, epochs: NDArray[np.int64]) -> Array:
    """Outputs (n, 8) of states (ticks, 13)."""
    y = x[epochs] @ readings_of(point, u).T
    for body, late in enumerate(point.rate_late):
        y[:, 6 + body] -= late * np.gradient(x[:, 1 + body], DT)[epochs]
    for k, lever in enumerate(point.levers):
        first = k // 2 * 2
        y[:, k] += point.pairs[k // 2] * (lever - (point.levers[first] + point.levers[first + 1]) / 2)
    y[:, 2:4] += point.aside
    return y


def whitened(point: TruePoint, u: float, columns: Array) -> Array:
    """Innovations of outputs (n, 8, m) by a filter of the point's motion, each of unit variance."""
    A, B = linearised(point.motion, u)
    grounds, slow = len(PUSHES) + 2, len(SLOW)
    n = N_MOTION + grounds + slow
    F, Q, H, P = np.zeros((n, n)), np.zeros((n, n)), np.zeros((OUTPUTS, n)), np.zeros((n, n))
    F[:N_MOTION, :N_MOTION] = A
    for k, (name, _) in enumerate(PUSHES):
        F[STATES.index(name), N_MOTION + k] = 1.0
    F[:N_MOTION, N_MOTION + 3 : N_MOTION + 5] = B[:, 1:]
    sds = np.array([*(sd for _, sd in PUSHES), UNEVEN, UNEVEN, *(sd for sd, _ in SLOW)])
    times = np.array([*[GROUND_M / u] * grounds, *(s for _, s in SLOW)])
    noise = np.arange(N_MOTION, n)
    F[noise, noise], Q[noise, noise] = -1.0 / times, 2.0 * sds**2 / times * DT
    H[:, :N_MOTION] = readings_of(point, u)
    H[:4, N_MOTION + grounds] = 1.0
    H[np.arange(4), N_MOTION + grounds + 1 + np.arange(4)] = 1.0
    P[np.arange(n), np.arange(n)] = np.concatenate([FIRST_SD, sds]) ** 2
    tick, by_noise = expm(F * DT), np.zeros((n, n))
    for _ in range(TICKS):
        by_noise = tick @ by_noise @ tick.T + Q
    x, out = np.zeros((n, columns.shape[2])), np.empty_like(columns)
    epoch = np.linalg.matrix_power(tick, TICKS)
    for k, reading in enumerate(columns):
        if k:
            x, P = epoch @ x, epoch @ P @ epoch.T + by_noise
        spread = H @ P @ H.T + np.diag(WHITE**2)
        e, gain = reading - H @ x, np.linalg.solve(spread, H @ P).T
        out[k] = np.linalg.solve(np.linalg.cholesky(spread), e)
        x, P = x + gain @ e, P - gain @ spread @ gain.T
        P = (P + P.T) / 2
    return out


# A drive.


def measured(machine: Machine, truth: Truth, seconds: tuple[float, float]) -> tuple[Array, NDArray[np.int64]]:
    """(outputs as they were measured (n, 8), samples of the truth at which). Raises ValueError where an epoch
    is missing."""
    rows = []
    for receiver in in_order(machine):
        heard = reports(machine, truth, receiver, FIRST_EPOCH_S)
        longitude, latitude = (
            [getattr(r, f"{name}_deg") for r in heard] for name in ("longitude", "latitude")
        )
        east, _ = plane().transform(longitude, latitude)
        drift = [r.speed * np.sin(r.course) for r in heard]
        at = np.round([r.epoch_s / STEP_S for r in heard]).astype(np.int64)
        rows.append(
            dict(zip(at.tolist(), zip(east, drift, (r.yaw_rate for r in heard), strict=True), strict=True))
        )
    begin, end = (round(at / STEP_S) for at in seconds)
    common = sorted(set.intersection(*(set(row) for row in rows)))
    stride = round(EPOCH_S / STEP_S)
    samples = np.array([k for k in common if begin <= k < end and (k - common[0]) % stride == 0])
    if len(samples) < 2 or np.any(np.diff(samples) != stride):
        raise ValueError("a bound needs reports of all four receivers at each 0.2 s")
    by_receiver = np.array([[row[k] for k in samples.tolist()] for row in rows])  # (4, n, 3)
    pairs = (by_receiver[0::2] + by_receiver[1::2]) / 2  # (2, n, 3)
    return np.column_stack([*by_receiver[:, :, 0], *pairs[:, :, 1], *pairs[:, :, 2]]), samples


def bound_of(
    machine: Machine, truth: Truth, seconds: tuple[float, float], file: Machine | None = None
) -> RowBound:
    """Of a stretch (from, to, s) of a row. machine: what was driven; file: whose sds are what is known
    before, the same if None. Raises ValueError where an epoch is missing."""
    y, samples = measured(machine, truth, seconds)
    stride = round(DT / STEP_S)
    first = samples[0] - round(1.0 / STEP_S)
    first = max(first - first % stride + samples[0] % stride, samples[0] % stride)
    wheel_angle = truth.wheel_angle[first : samples[-1] + 1 : stride]
    epochs = (samples - first) // stride
    u = float(np.mean(truth.tractor.forward_velocity[samples]))
    point = true_point(machine, truth)
    _, sd = unknowns.prior(file or machine)
    points, steps = [point], []
    for unknown, known in zip(UNKNOWNS, sd.tolist(), strict=True):
        ahead, behind = (moved(point, unknown, by) for by in (STEP * known, -STEP * known))
        if known > 0.0 and ahead is not None and behind is not None:
            points += [ahead, behind]
            steps.append(known)
    known_before = np.array(steps)
    found = response(points, u, wheel_angle, epochs)
    slopes = (found[:, :, 1::2] - found[:, :, 2::2]) / (2 * STEP * known_before)
    left = (y - found[:, :, 0])[:, :, None]
    rig = truth.rig
    way = rig.a + rig.c + rig.d + rig.e
    order = int(np.clip(np.ceil(PAST * way / u / EPOCH_S), *ORDERS))
    made = whitened(point, u, np.concatenate([left, slopes], axis=2))[round(SETTLING_S / EPOCH_S) - order :]
    innovations = [made[:, :, 0]]
    spread = likeliest_spread(innovations, order, SPREADS)
    noise = regress(innovations, order, spread)
    gradient, told = gradient_and_information(noise, [-made[:, :, 1:]])
    covariance = np.linalg.inv(told + np.diag(known_before**-2))
    wheel = truth.wheel_angle[samples[round(SETTLING_S / EPOCH_S) :]]
    return RowBound(
        np.sqrt(np.diag(covariance)[:6]),
        -(covariance @ gradient)[:6],
        noise.share_of_own(wheel),
        float(np.std(wheel)),
        spread,
        told,
        known_before,
    )
