"""One row for each number of a rig that a machine file may have wrong: its key, its unit, how it changes a
file, and how well people, drives and filters know it.

Whoever asks whether the file is right reads these rows: calibration of a drive, the open tracker, the watch
for what is moved while driving, and what an operator accepts. A new number is a row here. Bodies: t is the
tractor, i the implement.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from tilth.estimator.rig import adjustments
from tilth.estimator.rig.adjustments import Amount, Change, added, of_receiver, scaled
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

BODIES: Final = ("tractor", "implement")
DEG: Final = math.degrees(1.0)
CURVED: Final = DEG * math.radians(30.0) ** 2  # ° at 30° per 1/rad

ROW, CIRCLE, FOLD, WEAVE = (
    "drive straight there and back on one line, 150 m each way",
    "drive slow circles to both sides, at three angles of the wheels",
    "drive turns in which the implement folds by 20° and more, to both sides",
    "weave with the wheels, slowly and quickly, for a minute each",
)
_LEVER: Final = "a tape, from rear axle to antenna along the body"
_PIN: Final = "a tape, from rear axle to hitch pin"
_AXLE: Final = "a tape, from hitch pin to the axle"
_SIDE: Final = "a tape, from the middle of the body to the antenna"
_LEVEL: Final = "a level floor, each side once"


@dataclass(frozen=True, slots=True)
class RigNumber:
    """A row. Amounts are SI, on top of what the file says; 0 or none: it is not asked for."""

    name: str
    key: str  # of the machine file, as people are told
    change: Change  # a machine file by an amount
    words: str = ""  # for people
    unit: str = "m"  # for people
    per_unit: float = 1.0  # SI per unit

    place: bool = False  # where receivers stand

    # As a calibration drive tells it.
    prior_sd: float = 0.0  # by how much people are wrong
    wanted_sd: float = 0.0
    floor_sd: float = 0.0  # of what the model leaves out, which a longer drive does not reduce
    not_weaved_sd: float = 0.0  # the same where the wheels were turned in slow sharp turns only, as in fields
    drive: str = ""  # the manoeuvre that tells it
    tape: str = ""  # what tells it without driving

    # As the filters have it, whose unit these four sds have: the number's, or a logarithm.
    unknown: str = ""  # a row of filters.unknowns; else that of the same name, if there is one
    value: Callable[[Machine], float] | None = None  # filters have the logarithm of it over this
    open_sd: float = 0.0  # prior where it is left open, as wide as people are wrong in a file
    often: float = 1.0  # how much likelier than another it is wrong in a file
    allowed_sd: float = 0.0  # by which a right file may differ from what driving finds: error of the model
    uneven_sd: float = 0.0  # by how much more rough ground moves that, and less uneven one in proportion
    fit_sd: float = 0.0  # allowed_sd of a fit of whole windows, which is believed of it instead
    in_rows: bool = False  # straight driving tells it, too
    cg_of: str = ""  # of BODIES: it is counted from its CG, whose place has an sd of its own

    # As the watch compares what was with what is.
    watch_sd: float = 0.0  # prior
    drift_sd: float = 0.0  # by which it may drift while nothing is moved: other soil, other slope


def _length(section: str, key: str) -> Callable[[Machine], float]:
    return lambda machine: float(getattr(getattr(machine, section), key).value)


def _pair(body: str) -> RigNumber:
    return RigNumber(
        f"pair_{body[0]}", f"receiver.position on the {body}", adjustments.pair_turned(body),
        f"yaw of the {body}'s pair", "°", 1 / DEG, place=True,
        prior_sd=math.radians(3.0), wanted_sd=math.radians(0.1), floor_sd=math.radians(0.05),
        drive=ROW, tape=_SIDE,
        open_sd=math.radians(5.0), allowed_sd=math.radians(0.1),
        in_rows=True, watch_sd=0.05, drift_sd=0.002,
    )  # fmt: skip


def _longer(body: str) -> RigNumber:
    return RigNumber(
        f"longer_{body[0]}", f"receiver.position on the {body}", adjustments.pair_longer(body),
        f"distance of the {body}'s receivers", place=True, watch_sd=0.3, drift_sd=0.01,
    )  # fmt: skip


def _of_each(
    name: str, key: str, change: Callable[..., dict[str, object]], words: str = "", unit: str = "m",
    per_unit: float = 1.0, **others: float | str,
) -> tuple[RigNumber, ...]:  # fmt: skip
    """A number that each receiver has."""
    return tuple(
        RigNumber(
            f"{name}_{mount.value}", f"receiver.{mount.value}.{key}", of_receiver(mount, change),
            words.format(mount.value.replace("_", " ")), unit, per_unit, **others,  # type: ignore[arg-type]
        )
        for mount in Mount
    )  # fmt: skip


NUMBERS: Final = (
    *map(_longer, BODIES),
    *map(_pair, BODIES),
    RigNumber(
        "aside_t", "receiver.position (right)", adjustments.pair_right("tractor"),
        "tractor's receivers to the right", place=True,
        prior_sd=0.20, wanted_sd=0.01, floor_sd=0.004, drive=FOLD, tape=_SIDE, watch_sd=0.3, drift_sd=0.01,
    ),
    RigNumber(
        "aside_i", "receiver.position (right)", adjustments.pair_right("implement"),
        "implement's receivers to the right", place=True,
        prior_sd=0.20, wanted_sd=0.01, floor_sd=0.004, drive=ROW, tape=_SIDE,
        open_sd=0.5, allowed_sd=0.03, in_rows=True, watch_sd=0.3, drift_sd=0.01,
    ),
    RigNumber(
        "lever_t", "receiver.position (forward)", adjustments.pair_forward("tractor"),
        "tractor's receivers forward", place=True,
        prior_sd=0.20, wanted_sd=0.03, floor_sd=0.014, not_weaved_sd=0.06, drive=CIRCLE, tape=_LEVER,
    ),
    RigNumber(
        "lever_i", "receiver.position (forward)", adjustments.pair_forward("implement"),
        "implement's receivers forward", place=True,
        prior_sd=0.20, wanted_sd=0.03, floor_sd=0.010, not_weaved_sd=0.03, drive=CIRCLE, tape=_LEVER,
    ),
    RigNumber(
        "a", "tractor.a", added("tractor", "a"), value=_length("tractor", "a"),
        open_sd=0.4, allowed_sd=0.03, uneven_sd=0.19, cg_of="tractor",
    ),
    RigNumber(
        "b", "tractor.b", added("tractor", "b"), value=_length("tractor", "b"),
        open_sd=0.4, allowed_sd=0.03, uneven_sd=0.09, cg_of="tractor",
    ),
    RigNumber(
        "c", "tractor.c", added("tractor", "c"), "tractor.c, CG to hitch",
        prior_sd=0.20, wanted_sd=0.03, floor_sd=0.008, not_weaved_sd=0.055, drive=FOLD, tape=_PIN,
        value=_length("tractor", "c"), open_sd=0.4, allowed_sd=0.03, cg_of="tractor",
        watch_sd=0.3, drift_sd=0.01,
    ),
    RigNumber(
        "d", "implement.d", added("implement", "d"), "implement.d, hitch to CG",
        prior_sd=0.20, wanted_sd=0.02, floor_sd=0.008, not_weaved_sd=0.025, drive=FOLD, tape=_AXLE,
        value=_length("implement", "d"), open_sd=0.4, allowed_sd=0.02, cg_of="implement",
        watch_sd=0.3, drift_sd=0.01,
    ),
    RigNumber(
        "e", "implement.e", added("implement", "e"),
        open_sd=0.5, often=2.0, allowed_sd=0.15, fit_sd=0.05, cg_of="implement",
    ),
    RigNumber(
        "wheel_zero", "wheel_angle.zero or offset", added("wheel_angle", "zero", math.degrees),
        "wheel angle when straight", "°", 1 / DEG,
        prior_sd=math.radians(5.0), wanted_sd=math.radians(0.05), floor_sd=math.radians(0.015),
        drive=ROW, tape="none",
        open_sd=math.radians(5.0), allowed_sd=math.radians(0.3),
        in_rows=True, watch_sd=0.1, drift_sd=0.002,
    ),
    RigNumber(
        "wheel_gain", "wheel_angle.scale or gain", adjustments.wheel_gain, "scale of the wheel angle",
        "%", 0.01,
        prior_sd=0.15, wanted_sd=0.01, floor_sd=0.008, not_weaved_sd=0.01, drive=CIRCLE, tape="none",
        open_sd=0.4, allowed_sd=0.05, watch_sd=0.3, drift_sd=0.03,
    ),
    RigNumber(
        "wheel_curve", "wheel_angle.curve", added("wheel_angle", "curve"),
        "curvature of the wheel's linkage, at 30°", "°", 1 / CURVED,
        prior_sd=0.08, wanted_sd=0.2 / CURVED, drive=CIRCLE, tape="none",
    ),
    RigNumber(
        "ackermann", "tractor.ackermann", added("tractor", "ackermann"),
        "front wheels, share of Ackermann's angles", "%", 0.01,
        prior_sd=0.3, wanted_sd=0.15, floor_sd=0.1, drive=CIRCLE, tape="none", unknown="parallel",
    ),
    RigNumber(
        "latency", "receiver.latency or wheel_angle.delay", adjustments.all_late, "latency of the receivers",
        "ms", 1e-3,
        prior_sd=0.10, wanted_sd=0.010, floor_sd=0.006, not_weaved_sd=0.04, drive=WEAVE, tape="none",
        open_sd=0.1, allowed_sd=0.02,
    ),
    *_of_each("forward", "position", adjustments.forward, place=True),
    *_of_each("right", "position", adjustments.right, place=True),
    *_of_each("latency", "latency", adjustments.latency, unit="s", watch_sd=0.06, drift_sd=0.003),
    *_of_each(
        "roll_zero", "roll_zero", adjustments.roll_zero, "roll zero, {} receiver", "°", 1 / DEG,
        prior_sd=math.radians(3.0), wanted_sd=math.radians(0.1), drive=ROW, tape=_LEVEL,
    ),
    RigNumber(
        "m_i", "implement.mass or tractor.mass", scaled("implement", "mass"), open_sd=0.4, allowed_sd=0.6
    ),
    RigNumber(
        "I_t", "tractor.yaw_inertia or tractor.mass", scaled("tractor", "yaw_inertia"),
        open_sd=0.4, allowed_sd=0.08, uneven_sd=0.22,
    ),
    RigNumber(
        "I_i", "implement.yaw_inertia or implement.mass", scaled("implement", "yaw_inertia"),
        open_sd=0.4, often=4.0, allowed_sd=0.35,
    ),
    RigNumber(
        "wheel_speed_factor", "tractor.wheel_speed_factor", adjustments.wheel_speed_factor,
        "wheel-based over ground speed", "1",
    ),
)  # fmt: skip
"""floor_sd is by bench/calibration.py. not_weaved_sd: what the model leaves out of slip in such turns is
taken for what is late and for places along the body; root mean square errors after four fields of the planar
virtual tractor, in space they are a third of it.

often: the place of the implement's CG and its inertia change with each load, and no tape tells them. With e
at 4, right files of light carts had no C_ai; at 1, one number in 130 under a wrong e was beyond 4 sds; at 2,
one in 480.

uneven_sd is from 16 right rigs of the fleet on 1 and 2 cm; on even ground a, b and I_t came out no further
off than the tracker's sds say. The limits for an accusation were chosen without it, with as much margin; what
weighs numbers against each other, and methods over minutes, need it: a took the blame for a wheel angle 50 %
off, and C_af was given 4 sds off; right files were accused of inertias 1.8 times theirs. Half or twice the
inertia moves no number by 1.3 of its sds.

allowed_sd is from drives with right files. What tells of the implement's mass and yaw inertia themselves are
small forces between the bodies. The mass came out at half and less in fields with headland turns, in 4 of 10
on the planar plant and 1 of 4 in space; behind carts of 6 to 12 t in space at a quarter, and the inertia at a
third. In steps and turns e was 0.25 m off, on both plants; over all drives 0.16 m rms. The right file was
doubted to the end. Not to learn masses in sharp turns at all ends more such doubts: two of sixteen on a
stranger's fields, where numbers of the tracker then were 3 and 4 sds off. There the doubt was right.
"""
NUMBER: Final[Mapping[str, RigNumber]] = {number.name: number for number in NUMBERS}


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """What may happen to a rig at one moment while it drives: some numbers change together."""

    name: str  # by which it is accepted: it stands in logs, and is never renamed
    code: Code
    key: str  # of the machine file, as people are told
    numbers: tuple[str, ...]  # one for each of its amounts
    sign: float = 1.0  # of the numbers by its amounts
    least: float = 0.0  # smallest size of its amounts that is worth saying, SI
    absorbed: bool = False  # it is no fault: the poses learn it too


WHEEL: Final = "wheel_angle"
DRAWBAR: Final = "drawbar"
WHEEL_SPEED: Final = "wheel_speed"  # its amounts: wheel-based over ground speed at no slip, now and before
PAIRS: Final = ("pair_tractor", "pair_implement")

HYPOTHESES: Final = (
    *(
        Hypothesis(  # 2.5 cm turn a pair by half a degree
            mount.value, Code.RECEIVER_MOVED, f"receiver.{mount.value}.position",
            (f"forward_{mount.value}", f"right_{mount.value}"), least=0.025,
        )
        for mount in Mount
    ),
    *(
        Hypothesis(pair, Code.PAIR_TURNED, f"receiver.{pair}.position", (f"pair_{body[0]}",), least=0.007)
        for pair, body in zip(PAIRS, BODIES, strict=True)
    ),
    Hypothesis(WHEEL, Code.WHEEL_SLIPPED, "wheel_angle.zero", ("wheel_zero",), least=0.0087),
    Hypothesis(DRAWBAR, Code.DRAWBAR_CHANGED, "implement.d or tractor.c", ("d",), sign=-1.0, least=0.05),
    Hypothesis(WHEEL_SPEED, Code.TYRES_CHANGED, "tractor.wheel_speed_factor", ("wheel_speed_factor",)),
    *(
        Hypothesis(
            f"latency_{mount.value}", Code.RECEIVER_AT_ANOTHER_TIME, f"receiver.{mount.value}.latency",
            (f"latency_{mount.value}",), absorbed=True,
        )
        for mount in Mount
    ),
)  # fmt: skip
HYPOTHESIS: Final[Mapping[str, Hypothesis]] = {one.name: one for one in HYPOTHESES}


def changed(machine: Machine, amounts: Mapping[str, Amount]) -> Machine:
    """A machine file in which numbers are others. amounts: by name, SI. Raises KeyError for an unknown one.

    They change it in the order of NUMBERS: a pair is stretched and turned about its middle, then moved.
    """
    if unknown := amounts.keys() - NUMBER.keys():
        raise KeyError(f"{', '.join(sorted(unknown))}: no number of a rig")
    for number in NUMBERS:
        if number.name in amounts:
            machine = number.change(machine, amounts[number.name])
    return machine


def names(numbers: Iterable[RigNumber]) -> tuple[str, ...]:
    """Of rows."""
    return tuple(number.name for number in numbers)
