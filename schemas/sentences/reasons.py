"""Words of reasons (`schemas/reasons.py`).

A template is filled with what the reason is `of` and with its numbers `n`; `:share` writes the sd of a
logarithm as 95 %.
"""

from collections.abc import Mapping
from typing import Final

from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import german
from tilth.schemas.sentences.diagnosis import DIAGNOSES, Words
from tilth.schemas.sentences.german import GERMAN
from tilth.schemas.spread import share

ENGLISH: Final = "en"  # key of the tables of words

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
        "the wheel-angle sensor does not change while the rig turns: check sensor, linkage, plug and cable"
    ),
    Code.HEADING_NOT_OF_PAIR: "heading not from two receivers",
    Code.TURNING_IN_OR_OUT: "turning in or out",
    Code.SPEED_NOT_STEADY: "speed not steady",
    Code.TOO_LITTLE_STEERING: "too little steering",
    Code.HELD: "the wheels are held at one angle: steer to both sides",
    Code.NOT_STRAIGHT: "not a straight row",
    Code.LITTLE_OWN_STEERING: (
        "in the rows the steering only reacts to the ground: a dither of 0.3 degrees would help"
    ),
    Code.TOO_SHORT: "too short a time without a gap",
    Code.FIT_OVERTAKEN: "the fit of the previous window was late",
    Code.CONTRADICTED: "the data contradict the machine file",
    Code.INPUTS_NOT_FINITE: "an input is not a number",
    Code.RESULT_NOT_FINITE: "the result is not a number",
    Code.FILTER_SETTLING: "filter settling",
    Code.FILTER_OUT_OF_BOUNDS: "filter left its bounds",
    Code.MOST_SAMPLES_REJECTED: "most samples are rejected",
    Code.OUTLIER: "outlier",
    Code.SLIP_BEYOND_MODEL: "slip beyond the tyre model",
    Code.NO_STEADY_TURN_EXISTS: "no steady turn exists at these stiffnesses",
    Code.NOT_CONVERGED: "fit did not converge",
    Code.BEYOND_TYRES: "the fit gives impossible tyres",
    Code.TWO_PLACES: (
        "two sets of tyre parameters explain this driving about equally well: also steer in other ways"
    ),
    Code.OUTPUTS_NOT_MEASURED: "yaw rates or headings of both bodies are not measured",
    Code.NO_STEADY_TURN: "no steady turn in this run",
    Code.END_OF_SEARCH: "a parameter reached the limit of its search range",
    Code.FIT_LATE: "a fit was {n[0]:.1f} s late because this computer is busy; it is used from now on",
    Code.FIT_DROPPED: "a fit was not ready in time and was dropped",
    Code.FIT_GIVEN_UP: "a fit was not ready {n[0]:.0f} s after it was due and is abandoned",
    Code.NOTHING_LEARNED: "nothing has been learned yet",
    Code.NOTHING_FITTED: "no driving with steering has been fitted yet",
    Code.NO_ROWS_YET: "two minutes of straight rows have not been fitted yet",
    Code.NO_STEADY_TURN_YET: "no steady turn yet",
    Code.NO_WINDOW_YET: "no window has been fitted yet",
    Code.WIDE: "known only to {n[0]:share}: more steering is needed",
    Code.OF_THE_MASS: (
        "the machine file gives {of[0]} only to {n[0]:share}: weigh it; the stiffness per kilogram is "
        "known to {n[1]:share}"
    ),
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
        "depends on stiffnesses that two outputs cannot separate; with a free gain its interval is too narrow"
    ),
    Code.NOT_CONFIRMED: (
        "driving has not yet shown that the machine file is right{keys}: steer to and fro at working speed"
        "{seconds}"
    ),
    Code.NOT_DRIVEN: "nothing has been driven yet",
    Code.DOUBTED: (
        "driving does not agree well with the machine file ({of[0]}?): check it, or drive on and steer to "
        "and fro at working speed"
    ),
    Code.NOT_EXCLUDED: (
        "driving has not excluded an error of {of[0]} in the machine file, so this is known only to "
        "{n[0]:share}: steer to and fro by 3° or more at working speed, for {n[1]:.0f} s"
    ),
    Code.WIDENED: "{n[0]:share} of this allows for an error of {of[0]} in the machine file",
    Code.OTHER_SOIL: "the soil here may differ from where this was learned: {n[0]:share}",
    Code.NOT_KNOWN_HERE: (
        "the soil here may differ from where this was learned, so it is known only to {n[0]:share}"
    ),
    Code.FIRST_WITH_NUMBERS: "{of[0]}: the first of {others} that gives estimates",
    Code.FIRST_THOUGH_OLD: "{of[0]}: the first of {others} that gives estimates, though old",
    Code.SOIL_CHANGED_SINCE: (
        "{of[0]}: the soil changed {n[0]:.0f} s ago, after the last window that was fitted"
    ),
    Code.WINDOW_OLD: "{of[0]}: the last window that was fitted is {n[0]:.0f} s old",
    Code.NO_WINDOW: "{of[0]}: the next window has not been driven yet",
    Code.CLAIMS_LESS: "{of[0]}: the methods disagree, and it claims less than {others_and}",
    Code.IN_PATCHES: "{of[0]}: soil differs from place to place here, and this is for the present place",
    Code.KNOWS_MORE: "{of[0]}: it uses more of the drive than {others_and}, with which it disagrees",
    Code.ROWS_KNOW_MORE: "{of[0]}: it knows the numbers to {n[0]:share} on average, {of[1]} to {n[1]:share}",
    Code.ROWS_ALONE: "{of[0]}: no method that learns in turns has numbers",
    Code.NO_METHOD: "no method gives an estimate",
    Code.DISAGREE: (
        "{of[0]} and {of[1]} disagree: squared distance {n[0]:.0f} for {n[1]:.0f} parameters; chance "
        "allows {n[2]:.0f}"
    ),
    Code.SAVED_BY_ANOTHER_VERSION: "it is from another version",
    Code.SAVED_NOT_FINITE: "it holds a value that is not a number",
    Code.SAVED_WITHOUT_COVARIANCE: "its covariance is not valid",
    Code.SAVED_INCOMPLETE: "part of it is missing",
    Code.ESTIMATORS_FAILED: ("the estimators failed ({of[0]}: {of[1]}) and start again; frames are logged"),
}
METHODS: Final[Mapping[str, Mapping[str, str]]] = {
    ENGLISH: {
        "pem": "fits of whole manoeuvres", "tracker": "the running estimate",
        "steady_state": "steady turns", "rows": "straight rows", "place": "the memory of places",
    },
    GERMAN: german.METHODS,
}  # fmt: skip
"""What people hear of an estimator: what it learns from."""
LANGUAGES: Final[Mapping[str, Mapping[Code, str]]] = {ENGLISH: SENTENCES, GERMAN: german.SENTENCES}
DIAGNOSED: Final[Mapping[str, Mapping[Code, Words]]] = {ENGLISH: DIAGNOSES, GERMAN: german.DIAGNOSES}
AND: Final[Mapping[str, tuple[str, str, str, str]]] = {
    ENGLISH: (" and ", "any other", "now", " for {:.0f} s"),
    GERMAN: (" und ", "jedes andere", "jetzt", " {:.0f} s lang"),
}
_NOW: Final = (Code.NOTHING_LEARNED, Code.NOTHING_FITTED, Code.NO_STEADY_TURN_YET)
"""What says why nothing is learned now."""


class _Number(float):
    def __format__(self, spec: str) -> str:
        return share(self) if spec == "share" else super().__format__(spec)


def sentence(reason: Reason | None, language: str = ENGLISH) -> str:
    """The reason in words, without a full stop; "" for none."""
    if reason is None:
        return ""
    of = reason.of
    if reason.code in DIAGNOSES:
        return DIAGNOSED[language][reason.code](of, reason.numbers)
    join, other, now, lasting = AND[language]
    of = tuple(METHODS[language].get(name, name) for name in of)
    text = LANGUAGES[language][reason.code].format(
        of=of,
        n=[_Number(number) for number in reason.numbers],
        keys=f" ({', '.join(of)})" if of else "",
        seconds=lasting.format(*reason.numbers[:1]) if reason.numbers else "",
        others=", ".join(of[1:]),
        others_and=join.join(of[1:]) or other,
    )
    because = "; ".join(sentence(one, language) for one in reason.because)
    if not because:
        return text
    return f"{text} ({now}: {because})" if reason.code in _NOW else f"{text}: {because}"
