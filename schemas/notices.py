"""What a person is told: codes with named values, never sentences. Events carry one, refusals are one.

`sentences/` makes the words of them. A unit that is not SI, or is seconds of a span, is in the value's name.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

from tilth.schemas.readable import readable
from tilth.schemas.reasons import Reason


class NoticeCode(StrEnum):
    """What a notice says; `sentences/notices.py` has a row for each, whose fields name its values."""

    TEXT = "text"  # words from elsewhere: of an old log, of a person
    REASON = "reason"
    FLAG = "flag"  # a flag of poses begins
    OVER = "over"  # and ends

    # The log's time and its buses.
    SILENCE = "silence"
    MESSAGES_MISSING = "messages_missing"
    STEPPED_BACK = "stepped_back"
    COARSE_STAMPS = "coarse_stamps"
    BUS_CLOCK_APART = "bus_clock_apart"
    BUSES_APART = "buses_apart"
    STRAY_FRAMES = "stray_frames"

    # Who is who.
    RECEIVER_AT = "receiver_at"  # part of others
    ADDRESS = "address"  # part of others
    ADDRESSES_KEPT = "addresses_kept"
    ADDRESSES_DOUBTED = "addresses_doubted"
    ADDRESSES_CONFIRMED = "addresses_confirmed"
    ADDRESSES_CHANGED = "addresses_changed"
    ADDRESSES_UNREADABLE = "addresses_unreadable"
    RECOGNISED = "recognised"
    NONE_FITS = "none_fits"
    SEVERAL_FIT = "several_fit"
    TWIN_NAME = "twin_name"

    # Sensors.
    POSITIONS_REPEATED = "positions_repeated"
    POSITIONS_SLOW = "positions_slow"
    STANDS_STILL = "stands_still"
    MOVES_AGAIN = "moves_again"
    NOT_HEARD = "not_heard"
    NO_WHEEL_ANGLE = "no_wheel_angle"
    WITHOUT_RTK = "without_rtk"

    # The machine file, and what has been moved; each with the reason that its diagnosis gives.
    CONTRADICTED = "contradicted"
    FITS_AGAIN = "fits_again"
    MOVED = "moved"
    MOVED_EARLIER = "moved_earlier"
    MOVED_BACK = "moved_back"
    TYRES_CHANGED = "tyres_changed"
    TYRES_BACK = "tyres_back"
    ACCEPTED = "accepted"

    # Estimators.
    LOAD_TOLD = "load_told"
    LOAD_CHANGED = "load_changed"
    LOAD_OR_SOIL = "load_or_soil"
    SOIL_CHANGED = "soil_changed"
    SOIL_CHANGING = "soil_changing"
    STIFFNESSES_ANEW = "stiffnesses_anew"
    FACTOR = "factor"  # part of SOIL_CHANGED
    STORED_STATE_REFUSED = "stored_state_refused"

    # The daemon.
    ACCEPTED_EARLIER = "accepted_earlier"
    BUS_BACK = "bus_back"
    BUS_FAILED = "bus_failed"
    BUS_HEARD = "bus_heard"
    BUS_LOST_FRAMES = "bus_lost_frames"
    BUS_SILENT = "bus_silent"
    BUS_STAMPED = "bus_stamped"
    BUS_TROUBLE = "bus_trouble"
    CACHE_REFUSED = "cache_refused"
    CLOCK_SET = "clock_set"
    CLOCK_WRONG = "clock_wrong"
    COMPILER_FAILED = "compiler_failed"
    COMPILES_AT_OWN_PRIORITY = "compiles_at_own_priority"
    COMPILING = "compiling"
    COMPILING_ANEW = "compiling_anew"
    DELETED = "deleted"
    DISK_SILENT = "disk_silent"
    DISK_TROUBLE = "disk_trouble"
    END_MISSING = "end_missing"
    FINISHED = "finished"
    FITS_AT_OWN_PRIORITY = "fits_at_own_priority"
    FIT_FAILED = "fit_failed"
    IMPLEMENT_ASSUMED = "implement_assumed"
    IMPLEMENT_CHANGED = "implement_changed"
    IMPLEMENT_HEARD = "implement_heard"
    IMPLEMENT_STRANGE = "implement_strange"
    IMPLEMENT_LENGTHS = "implement_lengths"
    IMPLEMENT_UNDESCRIBED = "implement_undescribed"
    KERNELS_COMPILED = "kernels_compiled"
    KERNELS_REFUSED = "kernels_refused"
    LEARNED_REFUSED = "learned_refused"
    METHOD_REFUSED = "method_refused"
    NEW_RUN = "new_run"
    NOT_PUBLISHED = "not_published"
    NOT_RECORDING = "not_recording"
    NO_REPORT = "no_report"
    RECORDING_AGAIN = "recording_again"
    REPORT_AT_OWN_PRIORITY = "report_at_own_priority"
    REPORT_MADE = "report_made"
    RESUMED = "resumed"
    FIELD_MAP = "field_map"
    UNFINISHED = "unfinished"
    UNLOCKED = "unlocked"

    # Updates that nobody is present for.
    UPDATED = "updated"
    UPDATE_READY = "update_ready"
    UPDATE_CRASHED = "update_crashed"
    UPDATE_NOT_RECORDING = "update_not_recording"
    UPDATE_OTHER_PROCESSOR = "update_other_processor"
    UPDATE_SEVERAL = "update_several"
    UPDATE_UNSIGNED = "update_unsigned"
    UPDATE_UNKNOWN_KEY = "update_unknown_key"
    UPDATE_REVOKED_KEY = "update_revoked_key"
    UPDATE_FORGED = "update_forged"
    UPDATE_OLDER = "update_older"
    UPDATE_NO_ROOM = "update_no_room"
    UPDATE_UNREADABLE = "update_unreadable"
    UPDATE_REFUSED = "update_refused"

    # Why a run of an experiment is not done.
    BACKWARDS = "backwards"
    BEYOND_BRAKING = "beyond_braking"
    BEYOND_LATERAL = "beyond_lateral"
    BEYOND_WHEELS = "beyond_wheels"
    BY_THE_DRIVER = "by_the_driver"
    END_NOT_CONFIRMED = "end_not_confirmed"
    END_REFUSED = "end_refused"
    FIELD_ENDS = "field_ends"
    FOLLOWED_LITTLE = "followed_little"
    NOT_WITH_THE_BAR = "not_with_the_bar"
    NO_POSE_FOR = "no_pose_for"
    OFF_THE_BAR = "off_the_bar"
    POSE_UNKNOWN = "pose_unknown"
    PROMPTER_ENDED = "prompter_ended"
    PROMPTER_ENDED_EARLY = "prompter_ended_early"
    RECEIVERS_LOST = "receivers_lost"
    RTK_LOST = "rtk_lost"
    START_NOT_CONFIRMED = "start_not_confirmed"
    START_REFUSED = "start_refused"
    STOPPED = "stopped"
    TOO_FAST = "too_fast"
    TOO_SLOW = "too_slow"
    WHEELS_NOT_HEARD = "wheels_not_heard"


OF_FOLD: Final = frozenset({
    NoticeCode.IMPLEMENT_LENGTHS, NoticeCode.REASON, NoticeCode.FLAG, NoticeCode.OVER,
    NoticeCode.SILENCE, NoticeCode.STEPPED_BACK, NoticeCode.COARSE_STAMPS, NoticeCode.BUS_CLOCK_APART,
    NoticeCode.BUSES_APART, NoticeCode.STRAY_FRAMES, NoticeCode.ADDRESSES_KEPT, NoticeCode.ADDRESSES_DOUBTED,
    NoticeCode.ADDRESSES_CONFIRMED, NoticeCode.ADDRESSES_CHANGED, NoticeCode.RECOGNISED, NoticeCode.NONE_FITS,
    NoticeCode.SEVERAL_FIT, NoticeCode.TWIN_NAME, NoticeCode.POSITIONS_REPEATED, NoticeCode.POSITIONS_SLOW,
    NoticeCode.STANDS_STILL, NoticeCode.MOVES_AGAIN, NoticeCode.CONTRADICTED, NoticeCode.FITS_AGAIN,
    NoticeCode.MOVED, NoticeCode.MOVED_BACK, NoticeCode.TYRES_CHANGED, NoticeCode.TYRES_BACK,
    NoticeCode.ACCEPTED, NoticeCode.SOIL_CHANGED, NoticeCode.SOIL_CHANGING, NoticeCode.STIFFNESSES_ANEW,
    NoticeCode.LOAD_TOLD, NoticeCode.LOAD_CHANGED, NoticeCode.LOAD_OR_SOIL,
})  # fmt: skip
"""Of events that the fold makes: a replay of the same frames tells the same."""


Value = float | str


@dataclass(frozen=True, slots=True)
class Notice:
    """A code, its values by name, what it lists, and the reason that it gives."""

    code: NoticeCode
    values: Mapping[str, Value] = field(default_factory=dict)
    parts: tuple["Notice", ...] = ()
    reason: Reason | None = None


Report = Callable[[str, Notice], None]
"""Takes the kind of an event and what it tells, from any thread."""


def notice(code: NoticeCode, *parts: Notice, **values: Value) -> Notice:
    """With texts as they can be shown and encoded: file names are bytes on a disk."""
    shown = {name: readable(one) if isinstance(one, str) else one for name, one in values.items()}
    return Notice(code, shown, parts)


def reasoned(reason: Reason, code: NoticeCode = NoticeCode.REASON, **values: Value) -> Notice:
    """With a reason, or of a reason alone."""
    return replace(notice(code, **values), reason=reason)


def in_words(text: str) -> Notice:
    """Of words alone, as old logs have them."""
    return notice(NoticeCode.TEXT, text=text)
