"""What came over Zenoh, checked: bytes of anybody become values of schemas.flow, or a refusal in words.

Nothing here trusts its sender. A field that this version does not know is passed over; a value that no rig
can have makes its parameter invalid; whatever is not the message it should be is refused as a whole.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple, TypeVar

import numpy as np
import zenoh
from google.protobuf.message import DecodeError, Message

from tilth.estimator.models.parameters import GEOMETRY, RIG_PARAMETERS, TABLE_5_1, Rig, checked
from tilth.schemas.flow import (
    PARAMETERS,
    BodyPose,
    Estimate,
    Event,
    OwnSteering,
    ParameterEstimate,
    Pose,
    SoilPlace,
    Status,
    known_flags,
)
from tilth.schemas.notices import Notice, NoticeCode, in_words
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason, text_reason
from tilth.schemas.sentences import advice_sentence, event_sentence, sentence

LARGEST: Final = 64 * 1024  # bytes of a payload; an estimate has one or two thousand
LONGEST: Final = 500  # characters of a text that is passed on
_RANGE: Final = {row.name: (row.low, row.high) for row in RIG_PARAMETERS}
_N: Final = len(PARAMETERS)
_SYMMETRIC: Final = 1e-6  # of the largest variance
_BODY: Final = tuple(BodyPose.__dataclass_fields__)

M = TypeVar("M", bound=Message)


class Refused(Exception):
    """What came cannot be used; the text says why."""


class Antenna(NamedTuple):
    """Of a receiver: forward and right of its body's CG and above the ground, m."""

    mount: str
    forward: float
    right: float
    height: float


class HeardRig(NamedTuple):
    """The machine file of the daemon, as far as it is published."""

    name: str
    rig: Rig  # priors as soil-tyre parameters; what is not in a machine file has the defaults of the models
    prior_log_sd: tuple[float, ...]  # of PARAMETERS
    antennas: tuple[Antenna, ...]


def parse(message: type[M], data: bytes, encoding: str, most: int = LARGEST) -> M:
    """The message that these bytes are, `most` of them. Raises Refused."""
    name = message.DESCRIPTOR.name
    if len(data) > most:
        raise Refused(f"{len(data)} bytes are too many for {name}")
    wanted = f"application/protobuf;tilth.{name}"
    if encoding != wanted:
        raise Refused(f"its encoding is {encoding[:80]!r}, not {wanted!r}")
    found = message()
    try:
        found.ParseFromString(data)
    except DecodeError:
        raise Refused(f"not a {name}") from None
    return found


def estimate_of(data: bytes, encoding: str) -> Estimate:
    """Raises Refused."""
    message = parse(pb.SoilTireEstimate, data, encoding)
    names = tuple(row.name for row in message.parameters)
    if names != PARAMETERS:
        raise Refused(
            f"an estimate of {', '.join(names)[:80] or 'nothing'}: not this version's six parameters"
        )
    if message.t_ns == 0:
        raise Refused("an estimate without a time")
    covariance = tuple(message.log_covariance)
    wrong = _wrong_covariance(covariance)
    rows = tuple(_parameter(row, i, covariance, wrong) for i, row in enumerate(message.parameters))
    return Estimate(
        t_ns=message.t_ns,
        method=text(message.method),
        model=text(message.model),
        parameters=rows,
        log_covariance=() if wrong else covariance,
        per_mass=tuple(row.per_mass if row.HasField("per_mass") else None for row in message.parameters),
        per_mass_sd=tuple(
            row.per_mass_sd if row.HasField("per_mass_sd") else None for row in message.parameters
        ),
        nuisances={text(n.name): (n.value, n.sd) for n in message.nuisances},
        rank=message.rank,
        condition=message.condition if message.HasField("condition") else None,
        excitation={text(e.name): e.value for e in message.excitation},
        window_s=message.window_s,
        rule=_reason(message.chosen, message.rule),
        determined=tuple(Combination(tuple(one.exponents), one.log_sd) for one in message.combinations),
        bound=tuple(message.bound),
        advice=_advice(message.advised),
        own_steering=_own_steering(message),
        of_place=_of_place(message),
    )


def _of_place(message: pb.SoilTireEstimate) -> SoilPlace | None:
    if not message.HasField("of_place"):
        return None
    at = message.of_place
    return SoilPlace(
        at.latitude_deg, at.longitude_deg, at.radius_m, at.this_pass, at.neighbours, at.prior,
        tuple(at.log_mean),
    )  # fmt: skip


def _own_steering(message: pb.SoilTireEstimate) -> OwnSteering | None:
    if not message.HasField("own_steering"):
        return None
    own = message.own_steering
    return OwnSteering(own.share, own.rms, own.seconds)


def _parameter(row: pb.Parameter, i: int, covariance: Sequence[float], wrong: str) -> ParameterEstimate:
    value = row.value if row.HasField("value") else None
    sd = row.sd if row.HasField("sd") else None
    age_s = row.age_s if row.HasField("age_s") else None
    if int(row.status) not in set(map(int, Status)):
        return _invalid(f"status {row.status} is not known here")
    status = Status(row.status)
    reason = _reason(row.why, row.reason)
    if status is not Status.ESTIMATED:
        reason = reason or text_reason("no reason is given")
    elif fault := _fault(row, wrong or ("" if covariance[i * _N + i] > 0 else "it has no variance")):
        return _invalid(fault)
    return ParameterEstimate(value, sd, status, reason, age_s)


def _fault(row: pb.Parameter, of_covariance: str) -> str:
    """What is wrong with an estimate that says that it may be used."""
    low, high = _RANGE[row.name]
    value = row.value if row.HasField("value") else None
    sd = row.sd if row.HasField("sd") else None
    if value is None or not low <= value <= high:  # not a number is in no range
        return f"its value is {value}; a rig has {low:g} to {high:g}"
    if sd is None or not (math.isfinite(sd) and sd > 0):
        return f"its standard deviation is {sd}"
    if of_covariance:
        return of_covariance
    return f"its age is {row.age_s}" if row.HasField("age_s") and not row.age_s >= 0 else ""


def _invalid(why: str) -> ParameterEstimate:
    return ParameterEstimate(None, None, Status.INVALID, text_reason(why))


def _reason(coded: pb.Reason, words: str) -> Reason | None:
    """By its code where this version knows it and all that it needs; else in the sender's words."""
    try:
        because = tuple(filter(None, (_reason(one, "") for one in coded.because)))
        found = Reason(Code(coded.code), tuple(map(text, coded.of)), tuple(coded.numbers), because)
        sentence(found)
    except (ValueError, IndexError, RecursionError):
        return text_reason(text(words))
    return found


def _advice(sent: pb.Advice) -> Advice | None:
    """None where there is none, or one that this version has no words for."""
    if not set(sent.parameters) <= set(PARAMETERS) or sent.kind not in set(AdviceKind):
        return None
    advice = Advice(
        AdviceKind(sent.kind), tuple(sent.parameters), tuple(sent.log_sds), sent.determined, sent.speed,
        sent.manoeuvre, sent.seconds, sent.degrees, tuple(sent.after), text(sent.turn_tells), sent.turn_after,
    )  # fmt: skip
    try:
        advice_sentence(advice)
    except LookupError:
        return None
    return advice


def _wrong_covariance(covariance: Sequence[float]) -> str:
    """Why it is none, "" where it is one. Rows of parameters without an estimate may be zero."""
    if len(covariance) != _N * _N:
        return f"a covariance of {len(covariance)} numbers; {_N * _N} are needed"
    matrix = np.reshape(covariance, (_N, _N))
    if not np.isfinite(matrix).all():
        return "a covariance with something that is no number"
    scale = max(float(np.abs(matrix).max()), 1e-12)
    if np.abs(matrix - matrix.T).max() > _SYMMETRIC * scale:
        return "a covariance that is not symmetric"
    if np.linalg.eigvalsh(matrix)[0] < -_SYMMETRIC * scale:
        return "a covariance with a negative variance"
    return ""


def pose_of(data: bytes, encoding: str) -> Pose:
    """What came as a pose; numbers that are none are left out. Raises Refused."""
    message = parse(pb.Pose, data, encoding)
    origin = message.origin_latitude_deg, message.origin_longitude_deg
    if message.t_ns == 0 or not (abs(origin[0]) <= 90.0 and abs(origin[1]) <= 180.0):
        raise Refused("a pose without a time or a place")
    return Pose(
        message.t_ns, *origin, _body(message.tractor), _body(message.implement),
        _number(message, "articulation"), _number(message, "sd_articulation"),
        _number(message, "wheel_angle"), _number(message, "sd_wheel_angle"),
        message.direction, None, message.sd_time, message.receivers, known_flags(message.flags),
    )  # fmt: skip


def _body(message: pb.BodyPose) -> BodyPose:
    return BodyPose(*(_number(message, name) for name in _BODY))


def _number(message: pb.Pose | pb.BodyPose, name: str) -> float | None:
    if not message.HasField(name):
        return None
    value = float(getattr(message, name))
    return value if math.isfinite(value) else None


def event_of(data: bytes, encoding: str) -> Event:
    """Raises Refused."""
    message = parse(pb.Event, data, encoding)
    place = message.HasField("latitude_deg") and message.HasField("longitude_deg")
    latitude, longitude = (message.latitude_deg, message.longitude_deg) if place else (None, None)
    found = Event(message.t_ns, text(message.kind), in_words(text(message.text)), latitude, longitude)
    if not message.HasField("notice"):
        return found
    try:
        known = replace(found, notice=_notice(message.notice))
        event_sentence(known)
    except (LookupError, ValueError, TypeError, RecursionError):  # of another version: in the sender's words
        return found
    return known


def _notice(sent: pb.Notice) -> Notice:
    """Raises ValueError where this version does not know it."""
    values = {one.name: text(one.text) if one.HasField("text") else one.number for one in sent.values}
    reason = _reason(sent.reason, "") if sent.HasField("reason") else None
    return Notice(NoticeCode(sent.code), values, tuple(map(_notice, sent.parts)), reason)


def rig_of_message(data: bytes, encoding: str) -> HeardRig:
    """Raises Refused."""
    message = parse(pb.Rig, data, encoding)
    if tuple(row.name for row in message.priors) != PARAMETERS:
        raise Refused("a rig without priors of this version's six parameters")
    values = {name: getattr(message, name) for name in (*GEOMETRY, "h_t", "h_i")}
    values |= {row.name: row.value for row in message.priors}
    spread = tuple(row.log_sd for row in message.priors)
    antennas = tuple(Antenna(text(row.mount), row.forward, row.right, row.height) for row in message.antennas)
    numbers = [*spread, *(number for antenna in antennas for number in antenna[1:])]
    if not all(map(math.isfinite, numbers)) or min(spread) <= 0:
        raise Refused("a rig with something that is no number")
    try:
        return HeardRig(text(message.name), checked(TABLE_5_1._replace(**values)), spread, antennas[:4])
    except ValueError as error:
        raise Refused(f"a rig that cannot be: {error}") from None


def text(raw: str) -> str:
    """A text from the network, shortened and in one line."""
    return "".join(sign if sign.isprintable() else " " for sign in raw[:LONGEST])


def answered_age(attachment: zenoh.ZBytes | None) -> float:
    """Seconds since a value was published, of an answer to a query; infinite where a daemon of another
    version does not say."""
    try:
        age_s = float(attachment.to_string()) if attachment is not None else math.inf
    except ValueError:
        return math.inf
    return age_s if age_s >= 0 else math.inf
