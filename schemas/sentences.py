"""Words for people, in English: the one place that makes sentences of codes (`reasons.py`).

A template is filled with what the reason is `of` and with its numbers `n`; `:share` writes the sd of a
logarithm as 95 %.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from tilth.schemas.flow import PARAMETERS
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason
from tilth.schemas.spread import share

SENTENCES: Final[Mapping[Code, str]] = {
    Code.TEXT: "{of[0]}",
    Code.SETTLING: "settling",
    Code.REVERSE: "reverse",
    Code.TOO_SLOW: "too slow",
    Code.BEYOND_WHEEL_ANGLE: "wheels turned further than any lock",
    Code.BEYOND_ARTICULATION: "folded further than a turn at full lock",
    Code.POSE_GAP: "gap in the poses",
    Code.NEW_ORIGIN: "new origin of the plane",
    Code.NO_WHEEL_ANGLE: "no wheel angle",
    Code.RECEIVERS_MISPLACED: "receivers do not fit the rig",
    Code.NO_RTK: "no RTK fix",
    Code.NO_ROLL: "roll not measured",
    Code.NO_HEADING: "no heading",
    Code.POSE_INCOMPLETE: "pose incomplete",
    Code.RECEIVER_LATE: "late receiver",
    Code.FRAMES_LATE: "frames came late",
    Code.WHEEL_ANGLE_STANDS: (
        "the wheel-angle sensor stands still while the rig turns: sensor, linkage, plug or cable"
    ),
    Code.HEADING_NOT_OF_PAIR: "heading not from two receivers",
    Code.TURNING_IN_OR_OUT: "turning in or out",
    Code.SPEED_NOT_STEADY: "speed not steady",
    Code.TOO_LITTLE_STEERING: "too little steering",
    Code.HELD: "the wheels are held at one angle: steer to both sides",
    Code.TOO_SHORT: "too short a time without a gap",
    Code.FIT_OVERTAKEN: "the fit of the window before was late",
    Code.CONTRADICTED: "the data contradict the machine file",
    Code.INPUTS_NOT_FINITE: "inputs are no numbers",
    Code.RESULT_NOT_FINITE: "the result is not a number",
    Code.FILTER_SETTLING: "filter settling",
    Code.FILTER_OUT_OF_BOUNDS: "filter left its bounds",
    Code.MOST_SAMPLES_REJECTED: "most samples are rejected",
    Code.OUTLIER: "outlier",
    Code.SLIP_BEYOND_MODEL: "slip beyond the tyre model",
    Code.NO_STEADY_TURN_EXISTS: "no steady turn exists at these stiffnesses",
    Code.NOT_CONVERGED: "fit did not converge",
    Code.BEYOND_TYRES: "fit is beyond what tyres can be",
    Code.OUTPUTS_NOT_MEASURED: "yaw rates or headings of both bodies are not measured",
    Code.NO_STEADY_TURN: "no steady turn in this run",
    Code.END_OF_SEARCH: "a parameter went to the end of where it is sought",
    Code.FIT_LATE: "a fit was ready {n[0]:.1f} s late, since this computer is busy; it is used from here",
    Code.FIT_DROPPED: "a fit was not ready in time and was dropped",
    Code.FIT_GIVEN_UP: "a fit was not ready {n[0]:.0f} s after it was due and is given up",
    Code.NOTHING_LEARNED: "nothing has been learned yet",
    Code.NOTHING_FITTED: "no driving with steering has been fitted yet",
    Code.NO_STEADY_TURN_YET: "no steady turn yet",
    Code.NO_WINDOW_YET: "no window has been fitted yet",
    Code.WIDE: "the data leave {n[0]:share}: more steering is needed",
    Code.NOT_LEARNED_FOR: "nothing was learned for {n[0]:.0f} s",
    Code.NO_SOUND_DATA_FOR: "no sound data for {n[0]:.0f} s",
    Code.NO_STEADY_DRIVING_FOR: "no steady driving for {n[0]:.0f} s",
    Code.RANK: "rank {n[0]:.0f} of 3: more steady turns to both sides are needed",
    Code.RANK_WITHOUT_SIDESLIP: (
        "rank {n[0]:.0f} of 3: without sideslip three stiffnesses cannot be told apart"
    ),
    Code.RANK_OF_TWO_OUTPUTS: (
        "rank {n[0]:.0f} of 3: yaw rate and articulation do not tell three stiffnesses apart"
    ),
    Code.NO_RELAXATION: "steady driving carries no relaxation-length information",
    Code.ON_UNIDENTIFIABLE: (
        "stands on stiffnesses that two outputs do not tell apart; with a free gain its interval is too "
        "narrow"
    ),
    Code.NOT_CONFIRMED: (
        "driving has not shown yet that the machine file is right{keys}: steer to and fro at working speed"
    ),
    Code.NOT_DRIVEN: "nothing has been driven yet",
    Code.DOUBTED: (
        "driving does not agree well with the machine file ({of[0]}?): drive on, steer to and fro at working "
        "speed"
    ),
    Code.FIRST_WITH_NUMBERS: "{of[0]}: the first of {others} that gives estimates",
    Code.FIRST_THOUGH_OLD: "{of[0]}: the first of {others} that gives estimates, though old",
    Code.SOIL_CHANGED_SINCE: "{of[0]}: the soil changed {n[0]:.0f} s ago, after the last window of pem",
    Code.WINDOW_OLD: "{of[0]}: the last window of pem is {n[0]:.0f} s old",
    Code.NO_WINDOW: "{of[0]}: the last window of pem has not been driven yet",
    Code.CLAIMS_LESS: "{of[0]}: the methods disagree, and it claims less than {others_and}",
    Code.NO_METHOD: "no method gives an estimate",
    Code.DISAGREE: (
        "{of[0]} and {of[1]} disagree: squared distance {n[0]:.0f} over {n[1]:.0f} parameters, of which "
        "chance allows {n[2]:.0f}"
    ),
}
_NOW: Final = (Code.NOTHING_LEARNED, Code.NOTHING_FITTED, Code.NO_STEADY_TURN_YET)
"""What says why nothing is learned now."""


class _Number(float):
    def __format__(self, spec: str) -> str:
        return share(self) if spec == "share" else super().__format__(spec)


def sentence(reason: Reason | None) -> str:
    """The reason in words, without a full stop; "" for none."""
    if reason is None:
        return ""
    of = reason.of
    text = SENTENCES[reason.code].format(
        of=of,
        n=[_Number(number) for number in reason.numbers],
        keys=f" ({', '.join(of)})" if of else "",
        others=", ".join(of[1:]),
        others_and=" and ".join(of[1:]) or "any other",
    )
    because = "; ".join(map(sentence, reason.because))
    if not because:
        return text
    return f"{text} (now: {because})" if reason.code in _NOW else f"{text}: {because}"


class ManoeuvreWords(NamedTuple):
    """called: its name, with a place for the degrees; driven: the instruction to a driver."""

    called: str
    driven: str


MANOEUVRES: Final[Mapping[str, ManoeuvreWords]] = {
    "step": ManoeuvreWords(
        "a turn held at {degrees:g}°", "hold a turn for {seconds:g} s, wheels to about {degrees:g}°"
    ),
    "steps": ManoeuvreWords(
        "turns of {degrees:g}° to one side and the other",
        "turn to one side and the other, three seconds each, for {seconds:g} s, wheels to about {degrees:g}°",
    ),
    "chirp": ManoeuvreWords(
        "a chirp of {degrees:g}°",
        "weave the steering gently left and right, slow then quick, for {seconds:g} s, "
        "wheels to about {degrees:g}°",
    ),
    "turn": ManoeuvreWords(
        "a headland turn at {degrees:g}° or more",
        "turn at the headland with the wheels at {degrees:g}° or more",
    ),
}
"""Of estimator.models.manoeuvres.MANOEUVRES, those that may be advised."""


def advice_sentence(advice: Advice | None) -> str:
    """What is not determined, and which manoeuvre would help most, by how much; "" for none."""
    if advice is None:
        return ""
    if advice.kind is AdviceKind.TOO_SLOW:
        return f"nothing can be learned below {advice.speed:g} m/s"
    it = "it" if len(advice.parameters) == 1 else "them"
    parts = [_open(advice)]
    if advice.kind is AdviceKind.NOTHING_HELPS:
        parts.append(f"no {advice.seconds:g} s of steering at this speed would help much")
    elif advice.kind is AdviceKind.MANOEUVRE:
        called = MANOEUVRES[advice.manoeuvre].called.format(degrees=advice.degrees)
        parts.append(f"{advice.seconds:g} s of {called} would bring {it} to {share(*advice.after)}")
    if advice.turn_tells:
        parts.append(f"the next headland turn would bring {advice.turn_tells} to {share(advice.turn_after)}")
    return "; ".join(parts)


def _open(advice: Advice) -> str:
    names = listed(advice.parameters)
    if len(advice.parameters) == len(PARAMETERS):
        return f"none of {names} is determined"
    if advice.determined:
        state = "is known least"
    else:
        state = f"{'is' if len(advice.parameters) == 1 else 'are'} not determined"
    return f"{names} {state}: {share(*advice.log_sds)}"


def listed(names: Sequence[str]) -> str:
    """Such as: one, two and three."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def combination_words(one: Combination) -> str:
    """Such as: C_af/C_ar ±12 % (95 %)."""
    above = [_power(n, w) for n, w in zip(PARAMETERS, one.exponents, strict=True) if w > 0]
    below = [_power(n, -w) for n, w in zip(PARAMETERS, one.exponents, strict=True) if w < 0]
    above, below = (above, below) if above else (below, above)
    text = "·".join(above)
    if below:
        text = f"{text}/{below[0]}" if len(below) == 1 else f"{text}/({'·'.join(below)})"
    return f"{text} {share(one.log_sd)}"


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1.0 else f"{name}^{exponent:.1f}"
