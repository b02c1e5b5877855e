"""What the unknowns beside the six are called in a report, in which unit, and who states them."""

import math
from typing import Final, NamedTuple

from tilth.schemas.flow import Mount
from tilth.schemas.spread import of_logarithm, plus_minus


class NuisanceWords(NamedTuple):
    """form: ANGLE (rad), LENGTH (m), TIME (s), LOG (natural logarithm), PLAIN; unit: of what a LOG is of."""

    words: str
    form: str
    key: str = ""  # of the machine file; "": a usual value that no file states
    unit: str = ""
    scale: float = 1.0  # of what a LOG is of, to its unit


ANGLE, LENGTH, TIME, LOG, PLAIN = "angle", "length", "time", "log", "plain"
_SCALES: Final = {ANGLE: (180.0 / math.pi, "°"), LENGTH: (1e3, "mm"), TIME: (1e3, "ms"), PLAIN: (1.0, "")}
_SENSOR: Final = "sd of the machine file"
_ROLL_STIFFNESS: Final = "roll stiffness (Nm per rad of lean) over that of its track and deflection"

WORDS: Final[dict[str, NuisanceWords]] = {
    "wheel_zero": NuisanceWords("wheel-angle reading when straight", ANGLE, "wheel_angle.zero"),
    "wheel_gain": NuisanceWords("wheel-angle reading over true angle", LOG, "wheel_angle.gain"),
    "latency": NuisanceWords("receivers report later than stated", TIME, "receiver.latency"),
    "pair_t": NuisanceWords("tractor's pair of receivers turned right", ANGLE, "tractor.pair_yaw_sd"),
    "pair_i": NuisanceWords("implement's pair of receivers turned right", ANGLE, "implement.pair_yaw_sd"),
    "lever_t": NuisanceWords("tractor's receivers further forward", LENGTH, "receiver.position"),
    "lever_i": NuisanceWords("implement's receivers further forward", LENGTH, "receiver.position"),
    "aside_i": NuisanceWords("lateral offset of the implement's receivers from the tractor's", LENGTH,
                             "receiver.position"),
    "cg_t": NuisanceWords("tractor's CG further forward", LENGTH, "tractor.cg_sd"),
    "cg_i": NuisanceWords("implement's CG further forward", LENGTH, "implement.cg_sd"),
    "rolling": NuisanceWords("rolling resistance over load", PLAIN),
    "roll_k_t": NuisanceWords(f"tractor's {_ROLL_STIFFNESS}", LOG),
    "roll_k_i": NuisanceWords(f"implement's {_ROLL_STIFFNESS}", LOG),
    "roll_d_t": NuisanceWords("tractor's roll damping over nominal", LOG),
    "roll_d_i": NuisanceWords("implement's roll damping over nominal", LOG),
    "roll_j_t": NuisanceWords("tractor's roll inertia over nominal", LOG),
    "roll_j_i": NuisanceWords("implement's roll inertia over nominal", LOG),
    "roll_front": NuisanceWords("front axle's stiffness about its pivot over nominal", LOG),
    "roll_pin": NuisanceWords("front axle's pivot higher than nominal", LENGTH),
    "roll_hitch": NuisanceWords("drawbar higher than nominal", LENGTH),
    "roll_cg_t": NuisanceWords("tractor's CG higher", LENGTH, "tractor.cg_height"),
    "roll_cg_i": NuisanceWords("implement's CG higher", LENGTH, "implement.cg_height"),
    "camber": NuisanceWords("camber thrust over load and camber angle", PLAIN),
    "shrink": NuisanceWords("share by which relaxation lengths fall with slip", PLAIN),
    **{f"roll_zero_{mount.value}": NuisanceWords(f"roll zero of {mount.value}", ANGLE) for mount in Mount},
    "roll_late_t": NuisanceWords("delay of the tractor's rolls", TIME),
    "roll_late_i": NuisanceWords("delay of the implement's rolls", TIME),
    "rate_late_t": NuisanceWords("delay of the tractor's yaw rates", TIME),
    "rate_late_i": NuisanceWords("delay of the implement's yaw rates", TIME),
    "sway": NuisanceWords("share of the antenna's roll motion in roll-corrected speeds", PLAIN),
    "curvature": NuisanceWords("1 over largest side force per load", PLAIN),
    "two_track": NuisanceWords("how far the wheels of an axle slip each by itself", PLAIN),
    "parallel": NuisanceWords("how far both front wheels turn by the same angle", PLAIN),
    "push_t": NuisanceWords("disturbance force across the tractor, sd", LOG, unit="m/s²"),
    "push_i": NuisanceWords("disturbance force across the implement, sd", LOG, unit="m/s²"),
    "push_yaw": NuisanceWords("disturbance in yaw, sd", LOG, unit="rad/s²"),
    "memory": NuisanceWords("time constant of the disturbances", LOG, unit="s"),
    "uneven": NuisanceWords("ground's unevenness under the wheels of a body, sd", LOG, unit="°",
                            scale=180.0 / math.pi),
    "s_yaw_rate": NuisanceWords(f"noise of yaw rates over {_SENSOR}", LOG, "receiver.yaw_rate_sd"),
    "s_velocity": NuisanceWords(f"noise of velocities over {_SENSOR}", LOG, "receiver.velocity_sd"),
    "s_position": NuisanceWords(f"noise of positions over {_SENSOR}", LOG, "receiver.position_sd"),
    "s_roll": NuisanceWords(f"noise of rolls over {_SENSOR}", LOG, "receiver.roll_sd"),
    "a": NuisanceWords("tractor's CG to front axle over stated", LOG, "tractor.a"),
    "b": NuisanceWords("tractor's CG to rear axle over stated", LOG, "tractor.b"),
    "c": NuisanceWords("tractor's CG to hitch over stated", LOG, "tractor.c"),
    "d": NuisanceWords("hitch to implement's CG over stated", LOG, "implement.d"),
    "e": NuisanceWords("implement's CG to axle, further behind", LENGTH, "implement.e"),
    "m_t": NuisanceWords("tractor's mass over stated", LOG, "tractor.mass"),
    "m_i": NuisanceWords("implement's mass over stated", LOG, "implement.mass"),
    "I_t": NuisanceWords("tractor's yaw inertia over stated", LOG, "tractor.yaw_inertia"),
    "I_i": NuisanceWords("implement's yaw inertia over stated", LOG, "implement.yaw_inertia"),
}  # fmt: skip


def nuisance_value(name: str, value: float) -> str:
    """Value alone in people's units, to three digits."""
    row = WORDS[name]
    if row.form == LOG:
        found = f"{math.exp(value) * row.scale:.3g}"
        return f"{found} {row.unit}" if row.unit else f"× {found}"
    scale, unit = _SCALES[row.form]
    return " ".join(filter(None, (f"{value * scale:.3g}", unit)))


def nuisance_text(name: str, value: float, sd: float) -> str:
    """Value and 95 % interval in people's units; who shows it says that it is 95 %."""
    row = WORDS[name]
    if row.form == LOG:
        centre = math.exp(value) * row.scale
        return of_logarithm(centre, centre * sd, row.unit, bare=True)
    scale, unit = _SCALES[row.form]
    return plus_minus(value * scale, sd * scale, unit, bare=True)
