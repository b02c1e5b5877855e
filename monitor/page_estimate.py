"""What the page shows of an estimate: texts and numbers for the driver. Pure: JSON of messages in and out.

Whatever the page shows as ± or as a range is 95 %, by schemas.spread. Messages keep standard deviations.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

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
        "advised_de": "" if invalid else advised_in_german(estimate.get("advised")),
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


def advised(advice: Fields | None) -> str:
    """An estimate's advice (tilth.Advice) as a sentence for a driver; "" where there is none to give."""
    advice = advice or {"kind": ""}
    turn = advice.get("turn_tells", "")
    match advice["kind"]:
        case AdviceKind.TOO_SLOW:
            return f"Drive faster than {3.6 * advice['speed']:.1f} km/h: below, nothing can be learned."
        case AdviceKind.NOT_AT_THIS_SPEED:
            return "At this speed there is no gentle steering that would tell more."
        case AdviceKind.NOTHING_HELPS:
            if turn:
                return f"Drive on: the next headland turn tells more of the {_tyres(turn)}."
            return "Drive on: no steering at this speed would tell much more."
    if advice.get("manoeuvre") not in MANOEUVRES:
        return ""
    seconds, degrees = advice["seconds"], advice["degrees"]
    what = MANOEUVRES[advice["manoeuvre"]].driven.format(seconds=seconds, degrees=degrees)
    told = f"Where there is room, {what}: it would tell more of the {_tyres(*advice['parameters'])}."
    if turn:
        told += f" The next headland turn tells more of the {_tyres(turn)} by itself."
    return told


def advised_in_german(advice: Fields | None) -> str:
    """The same in German."""
    advice = advice or {"kind": ""}
    turn = advice.get("turn_tells", "")
    match advice["kind"]:
        case AdviceKind.TOO_SLOW:
            return f"Schneller als {3.6 * advice['speed']:.1f} km/h fahren: darunter ist nichts zu lernen."
        case AdviceKind.NOT_AT_THIS_SPEED:
            return "Bei dieser Geschwindigkeit sagt kein sanftes Lenken mehr."
        case AdviceKind.NOTHING_HELPS:
            if turn:
                return f"Weiterfahren: die nächste Wende sagt mehr über die Reifen {_german_tyres(turn)}."
            return "Weiterfahren: bei dieser Geschwindigkeit sagt kein Lenken viel mehr."
    if advice.get("manoeuvre") not in german.DRIVEN:
        return ""
    what = german.DRIVEN[advice["manoeuvre"]].format(seconds=advice["seconds"], degrees=advice["degrees"])
    told = f"Wo Platz ist: {what}. Das sagt mehr über die Reifen {_german_tyres(*advice['parameters'])}."
    return told + (f" Die nächste Wende sagt mehr über die Reifen {_german_tyres(turn)}." if turn else "")


def _groups(names: Sequence[str]) -> list[str]:
    return [GROUPS[PARAMETERS.index(name) % len(GROUPS)] for name in names]


def _tyres(*names: str) -> str:
    return f"{_and(_groups(names))} tyres"


def _german_tyres(*names: str) -> str:
    where = {"front": "vorn", "rear": "hinten", "implement": "am Gerät"}
    return _and([where[group] for group in _groups(names)], "und")


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
