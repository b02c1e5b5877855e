"""What the page shows of an estimate: texts and numbers for the driver. Pure: JSON of messages in and out.

Whatever the page shows as ± or as a range is 95 %, by schemas.spread. Messages keep standard deviations.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.reasons import AdviceKind
from tilth.schemas.sentences import MANOEUVRES, german, soil_words
from tilth.schemas.spread import WITHIN, even

Fields = dict[str, Any]


GROUPS: Final = ("front", "rear", "implement")  # of tyres, in the order of PARAMETERS, twice
WIDEST: Final = 50.0  # sd of a logarithm that is still a number about anything
LARGEST: Final = 1.0  # 95 % of a logarithm: beyond, a share says nothing


def page_estimate(estimate: Fields, rig: Fields | None) -> Fields:
    """What the page shows of an estimate: of each parameter its value, the half-width of its logarithm's
    95 %, status and reason; of each group of tyres a word; what to drive; what is withdrawn and why."""
    values, within, statuses = row(estimate)
    priors = {prior["name"]: prior["value"] for prior in (rig or {}).get("priors", ())}
    reasons = [one["reason"] for one in estimate["parameters"]]
    in_german = [one.get("reason_de", one["reason"]) for one in estimate["parameters"]]
    invalid = Status.INVALID in statuses
    return {
        "t": estimate["t_ns"] * 1e-9,
        "value": values,
        "within": within,
        "status": statuses,
        "why": reasons,
        "why_de": in_german,
        "known": [_share(sd) for sd in estimate["bound"]],
        "determined": estimate["determined"],
        "ground": [
            soil_words(values[i], within[i], statuses[i], priors.get(PARAMETERS[i]))
            for i in range(len(GROUPS))
        ],
        "place": _of_place(estimate.get("of_place")),
        "advised": "" if invalid else advised(estimate.get("advised")),
        "advised_de": "" if invalid else advised(estimate.get("advised"), IN_GERMAN),
        "withdrawn": withdrawn(statuses, reasons),
        "withdrawn_de": withdrawn(
            statuses, in_german, "Werte zurückgezogen", "der Rekorder sagt nicht warum"
        ),
    }


def _of_place(place: Fields | None) -> Fields | None:
    """Of an estimate of a place (tilth.SoilPlace): what its numbers rest on, for a bar, and in words."""
    if place is None:
        return None
    shares = [short(max(place[key], 0.0)) for key in ("this_pass", "neighbours", "prior")]
    passing, before, file = (f"{100 * share:.0f} %" for share in shares)
    words = (
        f"Of this place: {passing} by this pass, {before} by passes before, {file} by the machine file. "
        f"Soil is alike over {place['radius_m']:.0f} m."
    )
    in_german = (
        f"Von diesem Ort: {passing} aus dieser Überfahrt, {before} aus früheren, {file} aus der Datei. "
        f"Der Boden gleicht sich auf {place['radius_m']:.0f} m."
    )
    return {"shares": shares, "words": words, "words_de": in_german}


def row(estimate: Fields) -> tuple[list[float | None], list[float | None], list[int]]:
    """Of each parameter: value, half-width of the 95 % interval of its logarithm, status. Neither value nor
    width where one is missing, or where it is invalid."""
    n = len(PARAMETERS)
    covariance = estimate["log_covariance"]
    variances = covariance[:: n + 1] if len(covariance) == n * n else [None] * len(estimate["parameters"])
    rows = [_parameter(*pair) for pair in zip(estimate["parameters"], variances, strict=True)]
    return [one[0] for one in rows], [one[1] for one in rows], [one[2] for one in rows]


def _parameter(one: Fields, variance: float | None) -> tuple[float | None, float | None, int]:
    """As of `row`. variance: of the logarithm, where it is known."""
    value, sd, status = one.get("value"), one.get("sd"), one["status"]
    status = int(status if status in list(Status) else Status.INVALID)
    log_sd = math.sqrt(variance) if variance is not None and variance > 0 else None
    if value is not None and value > 0 and log_sd is None and sd:
        log_sd = sd / value
    if value is None or log_sd is None or not log_sd < WIDEST or status == Status.INVALID:
        return None, None, status
    return short(value), short(WITHIN * log_sd), status


def priors(rig: Fields) -> Fields:
    """The rig, each prior with the half-width of the 95 % interval of its logarithm beside its sd."""
    return rig | {"priors": [one | {"within": short(WITHIN * one["log_sd"])} for one in rig["priors"]]}


class AdviceWords(NamedTuple):
    """What is advised, in a language; {tyres} stands for the groups that something tells of."""

    too_slow: str
    not_at_this_speed: str
    turn_alone: str  # nothing else helps, but the next headland turn does
    nothing: str
    manoeuvre: str
    turn_too: str
    driven: Mapping[str, str]  # manoeuvre -> instruction
    groups: Mapping[str, str]  # of GROUPS
    joined: str


IN_ENGLISH: Final = AdviceWords(
    too_slow="Drive faster than {kmh:.1f} km/h: below, nothing can be learned.",
    not_at_this_speed="At this speed there is no gentle steering that would tell more.",
    turn_alone="Drive on: the next headland turn tells more of the {tyres} tyres.",
    nothing="Drive on: no steering at this speed would tell much more.",
    manoeuvre="Where there is room, {driven}: it would tell more of the {tyres} tyres.",
    turn_too=" The next headland turn tells more of the {tyres} tyres by itself.",
    driven={name: one.driven for name, one in MANOEUVRES.items()},
    groups={group: group for group in GROUPS},
    joined="and",
)
IN_GERMAN: Final = AdviceWords(
    too_slow="Schneller als {kmh:.1f} km/h fahren: darunter ist nichts zu lernen.",
    not_at_this_speed="Bei dieser Geschwindigkeit sagt kein sanftes Lenken mehr.",
    turn_alone="Weiterfahren: die nächste Wende sagt mehr über die Reifen {tyres}.",
    nothing="Weiterfahren: bei dieser Geschwindigkeit sagt kein Lenken viel mehr.",
    manoeuvre="Wo Platz ist: {driven}. Das sagt mehr über die Reifen {tyres}.",
    turn_too=" Die nächste Wende sagt mehr über die Reifen {tyres}.",
    driven=german.DRIVEN,
    groups={"front": "vorn", "rear": "hinten", "implement": "am Gerät"},
    joined="und",
)


def advised(advice: Fields | None, words: AdviceWords = IN_ENGLISH) -> str:
    """An estimate's advice (tilth.Advice) as a sentence for a driver; "" where there is none to give."""
    advice = advice or {"kind": ""}
    turn = advice.get("turn_tells", "")
    of_turn = _tyres(words, turn) if turn else ""
    match advice["kind"]:
        case AdviceKind.TOO_SLOW:
            return words.too_slow.format(kmh=3.6 * advice["speed"])
        case AdviceKind.NOT_AT_THIS_SPEED:
            return words.not_at_this_speed
        case AdviceKind.NOTHING_HELPS:
            return words.turn_alone.format(tyres=of_turn) if turn else words.nothing
    if advice.get("manoeuvre") not in words.driven:
        return ""
    driven = words.driven[advice["manoeuvre"]].format(seconds=advice["seconds"], degrees=advice["degrees"])
    told = words.manoeuvre.format(driven=driven, tyres=_tyres(words, *advice["parameters"]))
    return told + (words.turn_too.format(tyres=of_turn) if turn else "")


def _tyres(words: AdviceWords, *names: str) -> str:
    groups = (GROUPS[PARAMETERS.index(name) % len(GROUPS)] for name in names)
    return _and([words.groups[group] for group in groups], words.joined)


def withdrawn(
    statuses: Sequence[int],
    reasons: Sequence[str],
    said: str = "Numbers withdrawn",
    none: str = "the daemon gives no reason",
) -> list[str]:
    """A sentence for each reason why numbers are invalid."""
    names: dict[str, list[str]] = {}
    for name, status, reason in zip(PARAMETERS, statuses, reasons, strict=True):
        if status == Status.INVALID:
            names.setdefault(reason or none, []).append(name)
    return [f"{said}{_which(of)}: {reason}" for reason, of in names.items()]


def _which(names: Sequence[str]) -> str:
    return "" if len(names) == len(PARAMETERS) else f" ({', '.join(names)})"


def short(number: float) -> float:
    """The number with five digits: enough for a page."""
    return float(f"{number:.5g}")


def _share(log_sd: float | None) -> str | None:
    """In words how well a logarithm of that sd is known, 95 %; None: not at all."""
    if log_sd is None or not WITHIN * log_sd <= LARGEST:
        return None
    return even(100 * WITHIN * log_sd)


def _and(groups: Sequence[str], word: str = "and") -> str:
    each = list(dict.fromkeys(groups))
    return each[0] if len(each) == 1 else f"{', '.join(each[:-1])} {word} {each[-1]}"
