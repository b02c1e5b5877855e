"""Why there is no number, why driving teaches nothing, what would help: codes with numbers, never sentences.

`sentences/` makes the words of them, for people, and is the only place that does. Whoever decides by a
reason compares its code.
"""

from dataclasses import dataclass
from enum import StrEnum


class Code(StrEnum):
    """What a reason says. `of` and `numbers` of a Reason mean what stands beside its code."""

    TEXT = "text"
    """Words from elsewhere: of an old log, of an exception. of: the words."""

    # Driving that nothing is learned from: of a segment, a window or a pose.
    SETTLING = "settling"
    REVERSE = "reverse"
    TOO_SLOW = "too_slow"
    BEYOND_WHEEL_ANGLE = "beyond_wheel_angle"
    BEYOND_ARTICULATION = "beyond_articulation"
    POSE_GAP = "pose_gap"
    NEW_ORIGIN = "new_origin"
    NO_WHEEL_ANGLE = "no_wheel_angle"
    RECEIVERS_MISPLACED = "receivers_misplaced"
    NO_RTK = "no_rtk"
    NO_ROLL = "no_roll"
    NO_HEADING = "no_heading"
    POSE_INCOMPLETE = "pose_incomplete"
    RECEIVER_LATE = "receiver_late"
    FRAMES_LATE = "frames_late"
    WHEEL_ANGLE_STANDS = "wheel_angle_stands"
    """While the rig turns: the sensor has failed."""
    HEADING_NOT_OF_PAIR = "heading_not_of_pair"
    TURNING_IN_OR_OUT = "turning_in_or_out"
    SPEED_NOT_STEADY = "speed_not_steady"
    TOO_LITTLE_STEERING = "too_little_steering"
    HELD = "held"
    NOT_STRAIGHT = "not_straight"
    LITTLE_OWN_STEERING = "little_own_steering"
    """In a row, steering that answers the ground and does next to nothing else."""
    TOO_SHORT = "too_short"
    FIT_OVERTAKEN = "fit_overtaken"
    CONTRADICTED = "contradicted"
    """The data contradict the machine file. because: the findings."""

    # A filter or a fit that gave nothing.
    INPUTS_NOT_FINITE = "inputs_not_finite"
    RESULT_NOT_FINITE = "result_not_finite"
    FILTER_SETTLING = "filter_settling"
    FILTER_OUT_OF_BOUNDS = "filter_out_of_bounds"
    MOST_SAMPLES_REJECTED = "most_samples_rejected"
    OUTLIER = "outlier"
    SLIP_BEYOND_MODEL = "slip_beyond_model"
    NO_STEADY_TURN_EXISTS = "no_steady_turn_exists"
    NOT_CONVERGED = "not_converged"
    BEYOND_TYRES = "beyond_tyres"
    TWO_PLACES = "two_places"
    """Other tyres, more than a sd away, explain the window about as well."""
    OUTPUTS_NOT_MEASURED = "outputs_not_measured"
    NO_STEADY_TURN = "no_steady_turn"
    END_OF_SEARCH = "end_of_search"
    FIT_LATE = "fit_late"
    """numbers: s that it was late. It is used."""
    FIT_DROPPED = "fit_dropped"
    FIT_GIVEN_UP = "fit_given_up"
    """numbers: s since it was due."""

    # A parameter without a number, or with one that must not be used.
    NOTHING_LEARNED = "nothing_learned"
    """because: why nothing is learned now."""
    NOTHING_FITTED = "nothing_fitted"
    NO_STEADY_TURN_YET = "no_steady_turn_yet"
    NO_ROWS_YET = "no_rows_yet"
    NO_WINDOW_YET = "no_window_yet"
    WIDE = "wide"
    """numbers: sd of the logarithm that the data leave."""
    OF_THE_MASS = "of_the_mass"
    """of: the key of a mass. numbers: sd of its logarithm as the file tells it; sd of that of the stiffness
    over the mass, which has a number."""
    NOT_LEARNED_FOR = "not_learned_for"
    NO_SOUND_DATA_FOR = "no_sound_data_for"
    NO_STEADY_DRIVING_FOR = "no_steady_driving_for"
    """These three: numbers: s."""
    RANK = "rank"
    RANK_WITHOUT_SIDESLIP = "rank_without_sideslip"
    RANK_OF_TWO_OUTPUTS = "rank_of_two_outputs"
    """These three: numbers: rank, of three."""
    NO_RELAXATION = "no_relaxation"
    ON_UNIDENTIFIABLE = "on_unidentifiable"
    NOT_CONFIRMED = "not_confirmed"
    """of: keys that driving has not confirmed yet, or none. numbers: s of steering; or none."""
    NOT_DRIVEN = "not_driven"
    DOUBTED = "doubted"
    """of: the key of the machine file that agrees least."""
    NOT_EXCLUDED = "not_excluded"
    """of: a key of the machine file. numbers: sd of the logarithm with an error of it that driving has not
    excluded; s of steering that would."""
    WIDENED = "widened"
    """There is a number. of: a key of the machine file. numbers: sd of the logarithm that is added for it."""
    OTHER_SOIL = "other_soil"
    """There is a number. numbers: sd of its logarithm: soil may be otherwise here than where it is from."""
    NOT_KNOWN_HERE = "not_known_here"
    """numbers: the same, where it is too large for a number."""

    # Which method is recommended: the rule. of: the method, and then others.
    FIRST_WITH_NUMBERS = "first_with_numbers"
    FIRST_THOUGH_OLD = "first_though_old"
    SOIL_CHANGED_SINCE = "soil_changed_since"
    """numbers: s since the change."""
    WINDOW_OLD = "window_old"
    """numbers: s since pem's last window."""
    NO_WINDOW = "no_window"
    CLAIMS_LESS = "claims_less"
    """Of old logs."""
    KNOWS_MORE = "knows_more"
    ROWS_KNOW_MORE = "rows_know_more"
    """numbers: mean sd of the logarithms, and that of the other method."""
    ROWS_ALONE = "rows_alone"
    IN_PATCHES = "in_patches"
    """numbers: probability that soil differs from place to place."""
    NO_METHOD = "no_method"
    DISAGREE = "disagree"
    """of: two methods. numbers: squared distance, parameters both have, what chance allows."""

    # What an earlier run has learned, and is not used.
    SAVED_BY_ANOTHER_VERSION = "saved_by_another_version"
    SAVED_NOT_FINITE = "saved_not_finite"
    SAVED_WITHOUT_COVARIANCE = "saved_without_covariance"
    SAVED_INCOMPLETE = "saved_incomplete"

    ESTIMATORS_FAILED = "estimators_failed"
    """A fault of the program. of: the exception's kind and words."""
    # What is wrong with the machine file, or has been moved: of a Diagnosis. of: the key of the machine file,
    # then what stands beside the code. numbers: SI; where they have sds, all values first, then all sds.
    RECEIVER_NOT_THERE = "receiver_not_there"
    RECEIVER_EXCHANGED = "receiver_exchanged"
    RECEIVER_AT_ANOTHER_TIME = "receiver_at_another_time"
    """These three of: a mount."""
    OFF_WHERE_PARKED = "off_where_parked"
    """of: a number of the rig."""
    NO_LIKELY_LATENCY = "no_likely_latency"
    WHEEL_MOVES_ALONE = "wheel_moves_alone"
    WHEEL_OPPOSITE = "wheel_opposite"
    WHEEL_SCALE = "wheel_scale"
    """numbers: reading over what the path asks for."""
    WHEEL_UNRELATED = "wheel_unrelated"
    FARTHER_THAN_SPEED = "farther_than_speed"
    """of: a body. numbers: displacement over the integral of the speed."""
    ROLL_FOLLOWS_TURNS = "roll_follows_turns"
    """of: a body. numbers: rad per m/s^2."""
    LEAN_APART = "lean_apart"
    CORRECTED_TWICE = "corrected_twice"
    NOT_CORRECTED = "not_corrected"
    """These two of: a mount. numbers: response to roll over the height, sd."""
    ROLL_CORRECTION_UNCLEAR = "roll_correction_unclear"
    YAW_RATE_SMOOTHED = "yaw_rate_smoothed"
    """of: a mount. numbers: s, sd."""
    DRIVING_FINDS = "driving_finds"
    METHOD_FINDS = "method_finds"
    """These two of: a number of the rig, and then other keys that may be it, or the method. numbers: how far
    it is from the file, sd."""
    RECEIVER_OFF = "receiver_off"
    """numbers: how far forward and right of where the file has it, sds."""
    DRAWBAR_OFF = "drawbar_off"
    """numbers: by how much the file has it too long, sd. These two of: a row of what may be moved, and then
    other keys that may be it."""
    MOST_REJECTED = "most_rejected"
    """numbers: share of what the receivers say."""
    NO_TYRE = "no_tyre"
    """of: an axle. numbers: stiffness over load, 1/rad."""
    RECEIVER_MOVED = "receiver_moved"
    """numbers: forward and right."""
    PAIR_TURNED = "pair_turned"
    WHEEL_SLIPPED = "wheel_slipped"
    DRAWBAR_CHANGED = "drawbar_changed"
    """numbers: by how much it is shorter."""
    TYRES_CHANGED = "tyres_changed"
    """numbers: the factor of the wheel-based speed now and before. These five of: by which name it is
    accepted, and what else it may be."""


@dataclass(frozen=True, slots=True)
class Reason:
    """A code, and what it is about. SI, rad; logarithms natural."""

    code: Code
    of: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()
    because: tuple["Reason", ...] = ()


def text_reason(words: str) -> Reason | None:
    """Of words alone, as old logs have them; None without any."""
    return Reason(Code.TEXT, (words,)) if words else None


class AdviceKind(StrEnum):
    TOO_SLOW = "too_slow"  # nothing can be learned below `speed`
    NOT_AT_THIS_SPEED = "not_at_this_speed"  # no manoeuvre is mild enough at this speed
    NOTHING_HELPS = "nothing_helps"  # every manoeuvre would tell little more
    MANOEUVRE = "manoeuvre"


@dataclass(frozen=True, slots=True)
class Advice:
    """Which steering would tell more. Sds are of natural logarithms."""

    kind: AdviceKind
    parameters: tuple[str, ...] = ()  # of flow.PARAMETERS, that are not determined, or that are known least
    log_sds: tuple[float, ...] = ()  # theirs now
    determined: bool = False  # all six are: `parameters` is the one that is known least
    speed: float = 0.0  # m/s, for TOO_SLOW
    manoeuvre: str = ""  # for MANOEUVRE: a row of estimator.models.manoeuvres.MANOEUVRES
    seconds: float = 0.0
    degrees: float = 0.0  # of the front wheels
    after: tuple[float, ...] = ()  # sds of `parameters` after it
    turn_tells: str = ""  # the parameter that the next headland turn tells most of, or ""
    turn_after: float = 0.0  # its sd after that


@dataclass(frozen=True, slots=True)
class Combination:
    """A product of powers of the parameters that data and prior determine."""

    exponents: tuple[float, ...]  # in the order of flow.PARAMETERS
    log_sd: float
