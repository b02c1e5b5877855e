"""Words of notices (`schemas/notices.py`), and of the events that carry them."""

from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from string import Formatter
from typing import Final

from tilth.schemas.flow import Event, FlagKind
from tilth.schemas.notices import Notice, NoticeCode
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import german_notices
from tilth.schemas.sentences.german import GERMAN
from tilth.schemas.sentences.reasons import ENGLISH, sentence

Words = str | Callable[..., str]
"""A template of a notice's values and of MADE; or what makes words of the values."""
MADE: Final = frozenset({"parts", "listed", "reason", "ended", "hitched", "which"})
"""Fields of a template that are no values: `ended` is the reason with its full stop, `hitched`
that another implement may be hitched on, `which` what a diagnosis is of."""

DAY_S: Final = 86_400.0

BEGUN: Final[Mapping[str, str]] = {
    FlagKind.LOST: "gives no usable position",
    FlagKind.WAITING: "has given no position yet",
    FlagKind.FLOATING: "lost its RTK fix (float)",
    FlagKind.NO_RTK: "has no RTK fix",
    FlagKind.NO_FIX: "has no position fix",
    FlagKind.REPEATING: "repeats old positions",
    FlagKind.SWAPPED: "is in another receiver's place: two receivers are exchanged",
    FlagKind.MOVED: "is not where the machine file says",
    FlagKind.DOUBTFUL: "does not fit the rig at this instant",
    FlagKind.LATE: "is late; its position is extrapolated",
    FlagKind.LATENCY: "reports later than the machine file allows, or was moved along the body",
    FlagKind.SPIKES: "sends readings that jump; they are left out: check its cable and plugs",
    FlagKind.FIX_UNKNOWN: "no longer reports its fix",
}
"""Of a flag that begins, said of its sensor."""
BEGUN_ALONE: Final[Mapping[str, str]] = {
    FlagKind.LATE_FRAMES: (
        "frames came late: this computer or the sending one is busy; nothing is learned meanwhile"
    ),
}
"""The same, said of the rig."""
_STANDING: Final = {
    "velocity": "velocity", "yaw_rate": "turn rate", "heading": "heading", "roll": "roll",
}  # fmt: skip


def _flag(*, flag: str, of: str, times: float = 1.0) -> str:
    if flag in BEGUN_ALONE:
        return BEGUN_ALONE[flag]
    silent = of == "wheel_angle" and flag != FlagKind.SPIKES
    again = f" (for the {times:.0f}th time)" if times > 1.0 else ""
    return f"{of} {'is silent' if silent else BEGUN[flag]}{again}"


def _stray(
    *,
    bus: str,
    frames: float,
    least_s: float,
    most_s: float,
    source: float | None = None,
    identifier: str = "",
) -> str:
    sender = f"identifier {identifier}" if source is None else f"source {source:.0f}"
    if most_s < 0:
        apart = f"{_between(-most_s, -least_s)} behind"
    elif least_s > 0:
        apart = f"{_between(least_s, most_s)} ahead of"
    else:
        apart = f"up to {_between(0.0, -least_s)} behind and {_between(0.0, most_s)} ahead of"
    number, verb = ("1 frame", "is") if frames == 1 else (f"{frames:.0f} frames", "are")
    return f"{number} of {sender} on {bus} {verb} stamped {apart} the rest: left out"


def _between(least_s: float, most_s: float) -> str:
    unit_s, unit = (DAY_S, "days") if most_s >= 2 * DAY_S else (1.0, "s")
    least, most = f"{least_s / unit_s:.1f}", f"{most_s / unit_s:.1f}"
    return f"{most} {unit}" if least == most or not least_s else f"{least} to {most} {unit}"


def _bus_apart(*, bus: str, behind_s: float) -> str:
    side = "behind" if behind_s > 0 else "ahead of"
    return (
        f"the clock of {bus} is {_between(0.0, abs(behind_s))} {side} that of the other buses: it is aligned "
        "by the order of the frames in the log"
    )


def _coarse(*, step_s: float) -> str:
    steps = "whole seconds" if step_s == round(step_s) else f"steps of {step_s:g} s"
    return (
        f"the stamps of the log are {steps}: what came within one cannot be told apart in time; record with "
        "finer ones"
    )


def _stands_still(*, of: str, quantity: str, still_s: float) -> str:
    still = f"stands still: the same reading for {still_s:.1f} s while the rig moved"
    text = f"{_standing(of, quantity)} {still}"
    if of == quantity == "wheel_angle":
        return f"{text}. No number is given until it moves again: look at sensor, linkage, plug and cable"
    return f"{text}. It is not used until it moves again: start the sender anew, look at its cable"


def _standing(of: str, quantity: str) -> str:
    if of == "wheel_angle":
        return "the wheel-angle sensor" if quantity == "wheel_angle" else "the wheels' speed"
    return f"{of}: its {_STANDING[quantity]}"


def _moves_again(*, of: str, quantity: str) -> str:
    return f"{_standing(of, quantity)} moves again"


def _clock_wrong(*, ahead_s: float) -> str:
    days = abs(ahead_s) / DAY_S
    size = f"{days:.1f} days" if days > 1 else f"{abs(ahead_s):.0f} s"
    return f"the computer's clock is {size} {'less' if ahead_s > 0 else 'more'} than UTC; the log says so"


_ACCEPT: Final = "It is not used: accept it as it is now ({which}), or put it back"

NOTICES: Final[Mapping[NoticeCode, Words]] = {
    NoticeCode.TEXT: "{text}",
    NoticeCode.REASON: "{reason}",
    NoticeCode.FLAG: _flag,
    NoticeCode.OVER: "{of}: over",
    NoticeCode.SILENCE: "no frame for {silence_s:.1f} s",
    NoticeCode.MESSAGES_MISSING: "{file}: {why}",
    NoticeCode.STEPPED_BACK: (
        "the clock of the log stepped back by {by_s:.1f} s; positions are aligned again"
    ),
    NoticeCode.COARSE_STAMPS: _coarse,
    NoticeCode.BUS_CLOCK_APART: _bus_apart,
    NoticeCode.BUSES_APART: (
        "by the UTC of the receivers the clock of {ahead} is {apart_s:.1f} s ahead of that of {behind}: "
        "their messages cannot be combined; use one clock"
    ),
    NoticeCode.STRAY_FRAMES: _stray,
    NoticeCode.RECEIVER_AT: "{mount} at address {source:.0f}",
    NoticeCode.ADDRESS: "{source:.0f} on {bus}",
    NoticeCode.ADDRESSES_KEPT: (
        "{bus} was silent for {silence_s:.0f} s: receivers keep their addresses: {parts}"
    ),
    NoticeCode.ADDRESSES_DOUBTED: (
        "receivers may have other addresses than before: they are identified by their positions"
    ),
    NoticeCode.ADDRESSES_CONFIRMED: (
        "receivers have the addresses that they had before, as positions over {travel:.1f} m of travel "
        "confirm: {parts}"
    ),
    NoticeCode.ADDRESSES_CHANGED: (
        "receivers have other addresses than before, as positions over {travel:.1f} m of travel show: {parts}"
    ),
    NoticeCode.ADDRESSES_UNREADABLE: (
        "the addresses of earlier runs are not known: {file} cannot be used ({error})"
    ),
    NoticeCode.RECOGNISED: (
        "no address claim identifies the receivers: they are recognised by their positions over "
        "{travel:.1f} m of travel: {parts}"
    ),
    NoticeCode.NONE_FITS: (
        "neither address claims nor positions identify the receivers at addresses {parts}: no assignment "
        "fits the rig; give them by source in the machine file, or switch them off and on"
    ),
    NoticeCode.SEVERAL_FIT: (
        "neither address claims nor positions identify the receivers at addresses {parts}: more than one "
        "assignment fits the rig; give them by source in the machine file, or switch them off and on"
    ),
    NoticeCode.TWIN_NAME: (
        "two devices claim NAME {name} (addresses {source:.0f} and {other:.0f} on {bus}): it identifies "
        "neither; give them by source in the machine file"
    ),
    NoticeCode.POSITIONS_REPEATED: (
        "{of} sends each position {times:.0f} times: {per_s:.1f} a second are new, the others are left out; "
        "set its output rate to that of its positions"
    ),
    NoticeCode.POSITIONS_SLOW: "{of} gives only {per_s:.1f} positions a second; set it to 5 or more",
    NoticeCode.STANDS_STILL: _stands_still,
    NoticeCode.MOVES_AGAIN: _moves_again,
    NoticeCode.NOT_HEARD: "not heard: {mounts}",
    NoticeCode.NO_WHEEL_ANGLE: "not heard: the wheel angle",
    NoticeCode.WITHOUT_RTK: "without RTK fix: {mounts}",
    NoticeCode.CONTRADICTED: "{ended}{hitched} No number is given until this is over",
    NoticeCode.FITS_AGAIN: "{key}: over; the data fit the machine file again",
    NoticeCode.MOVED: "{reason}; {ago_min:.0f} min ago. " + _ACCEPT,
    NoticeCode.MOVED_EARLIER: "an earlier run found: {reason}. " + _ACCEPT,
    NoticeCode.MOVED_BACK: "{what} is where it was before, and is used again",
    NoticeCode.TYRES_CHANGED: "{reason}. No estimate uses it; accept it as it is now ({which})",
    NoticeCode.TYRES_BACK: "the tyres' radius is what it was before: {key}",
    NoticeCode.ACCEPTED: "accepted: {reason}; for the machine file: {line}",
    NoticeCode.LOAD_TOLD: "the implement carries {carried}; source: {source}",
    NoticeCode.LOAD_CHANGED: (
        "the implement carries more or less than before: the stiffness of its tyres over its mass has "
        "changed, that of the tractor's tyres has not. C_ai gets a number again when the load is "
        "entered, such as with `tilth implement --load full`"
    ),
    NoticeCode.LOAD_OR_SOIL: (
        "the implement carries more or less than before, or the soil holds the tyres differently: driving "
        "does not show which. Enter the load, such as with `tilth implement --load full`"
    ),
    NoticeCode.SOIL_CHANGED: (
        "the soil holds the tyres differently{listed}: what was learned before is discarded"
    ),
    NoticeCode.SOIL_CHANGING: (
        "the soil holds the tyres differently: what was learned before is discarded; further driving shows "
        "by how much"
    ),
    NoticeCode.STIFFNESSES_ANEW: (
        "measurements no longer fit what {turning_s:.0f} s of turning showed: the stiffnesses are learned "
        "again"
    ),
    NoticeCode.FACTOR: "{parameter} × {low:.2f} to {high:.2f}",
    NoticeCode.STORED_STATE_REFUSED: "{file}: its stored state is not used: {why}; continuing without it",
    NoticeCode.ACCEPTED_EARLIER: (
        "{what} is as it was accepted in an earlier run, not as the machine file says"
    ),
    NoticeCode.BUS_BACK: (
        "{bus}: works again after {down_s:.1f} s (failure {failure:.0f}, opening {opening:.0f})"
    ),
    NoticeCode.BUS_FAILED: (
        "{bus}: {why}; it is tried again (failure {failure:.0f}, {frames:.0f} frames until then)"
    ),
    NoticeCode.BUS_HEARD: "{bus}: heard again after {silence_s:.1f} s (silence {silence:.0f})",
    NoticeCode.BUS_LOST_FRAMES: "{bus}: {frames:.0f} {what} ({in_all:.0f} in all)",
    NoticeCode.BUS_SILENT: (
        "{bus}: silent, no frame for {silence_s:.1f} s (silence {silence:.0f}), {frames:.0f} until then"
    ),
    NoticeCode.BUS_STAMPED: "{bus}: its frames are stamped by {by}",
    NoticeCode.BUS_TROUBLE: "{bus}: {why}",
    NoticeCode.CACHE_REFUSED: "{why}",
    NoticeCode.CLOCK_SET: (
        "the computer's clock was set by {by_s:+.3f} s; the log's own clock is not affected"
    ),
    NoticeCode.CLOCK_WRONG: _clock_wrong,
    NoticeCode.COMPILER_FAILED: (
        "the process that compiles has failed ({why}); it is done beside the recording, which takes frames "
        "later than usual meanwhile"
    ),
    NoticeCode.COMPILES_AT_OWN_PRIORITY: "kernels are compiled at the recorder's own priority: {why}",
    NoticeCode.COMPILING: (
        "compiling kernels, once per machine: frames are recorded meanwhile, estimates follow"
    ),
    NoticeCode.COMPILING_ANEW: (
        "compiling kernels, which cannot be kept here: frames are recorded meanwhile, estimates follow"
    ),
    NoticeCode.DELETED: "{run} was deleted to make room: {megabytes:.0f} MB",
    NoticeCode.DISK_SILENT: "{folder}: the disk does not answer; the end of the log may be missing",
    NoticeCode.DISK_TROUBLE: "{why}",
    NoticeCode.END_MISSING: "the end of the log may be missing: {why}",
    NoticeCode.FINISHED: "{file} was left unfinished; finished now: {messages:.0f} messages",
    NoticeCode.FITS_AT_OWN_PRIORITY: "fits are made at the recorder's own priority: {why}",
    NoticeCode.FIT_FAILED: "a fit of {method} failed: {why}",
    NoticeCode.IMPLEMENT_ASSUMED: (
        "nobody has said which of {all} is hitched: {implement} is assumed; choose the implement on the "
        "page or with `tilth implement NAME`"
    ),
    NoticeCode.IMPLEMENT_CHANGED: "{implement} is hitched: a new run begins",
    NoticeCode.IMPLEMENT_HEARD: (
        "a device of {implement} is heard (NAME {device}), and none of the previous implement: {implement} "
        "is hitched, and a new run begins"
    ),
    NoticeCode.IMPLEMENT_LENGTHS: (
        "driving has shown the lengths of {implement}: hitch to axle {drawbar}, hitch to the middle of its "
        "receivers {receivers}. These are used; estimation starts again. For better estimates, measure "
        "from hitch pin to axle with a tape, and weigh the implement"
    ),
    NoticeCode.IMPLEMENT_STRANGE: (
        "{device} (NAME {name}) is heard, but is in no implement's file; estimates are for {implement}. If "
        'the device belongs to it, write names = ["{name}"] into [implement] of its file. If not, make '
        "a file for the new implement: measure its mass, its track, hitch to axle and the places of "
        "its receivers; `tilth calibrate` finds the lengths from driving"
    ),
    NoticeCode.IMPLEMENT_UNDESCRIBED: (
        "{device} (NAME {name}) is heard, but is in no implement's file, and no device of {implement} is "
        "heard: a run begins with an undescribed implement. First, driving finds its lengths: stand, "
        "then turn to both sides, at two speeds. Make a file for it: measure its mass, its track, "
        'hitch to axle and the places of its receivers, and write names = ["{name}"] into its '
        "[implement]"
    ),
    NoticeCode.KERNELS_COMPILED: (
        "kernels were compiled for {compiling_s:.0f} s while frames were recorded; estimates begin"
    ),
    NoticeCode.KERNELS_REFUSED: "kernels could not be prepared ({why}); estimates may come late",
    NoticeCode.LEARNED_REFUSED: "what earlier runs learned is not used: {why}",
    NoticeCode.METHOD_REFUSED: "what {method} learned in earlier runs is not used: {reason}",
    NoticeCode.NEW_RUN: "ignition is on: a new run begins in {file}",
    NoticeCode.NOT_PUBLISHED: "nothing is published: {why}; correct [zenoh] in the machine file",
    NoticeCode.NOT_RECORDING: "not recording: {why}",
    NoticeCode.NO_REPORT: "no report of the run so far: {why}",
    NoticeCode.RECORDING_AGAIN: "recording again in {file}; {missed:.0f} frames were not recorded",
    NoticeCode.REPORT_AT_OWN_PRIORITY: "the report is made at the recorder's own priority: {why}",
    NoticeCode.REPORT_MADE: "report of the run so far: {file}",
    NoticeCode.RESUMED: "{methods} continue from what was learned until {hours:.1f} h ago",
    NoticeCode.FIELD_MAP: "place and tracker begin from the field map, last driven {hours:.1f} h ago",
    NoticeCode.UNFINISHED: "{file} was left unfinished and stays so: {why}",
    NoticeCode.UNLOCKED: (
        "{folder}: this file system has no locks; recording continues, but other programs cannot see that "
        "a file is being written: do not use `tilth recover` there meanwhile"
    ),
    NoticeCode.UPDATED: "updated from {before} to {version}, which records",
    NoticeCode.UPDATE_READY: (
        "{file} is installed and waits: {version} runs from the next ignition off or start on. The stick is "
        "no longer needed"
    ),
    NoticeCode.UPDATE_CRASHED: (
        "the update to {version} was taken back, {before} runs again: it ended {times:.0f} times within its "
        "first minutes; {version} is not tried again"
    ),
    NoticeCode.UPDATE_NOT_RECORDING: (
        "the update to {version} was taken back, {before} runs again: it recorded nothing within "
        "{within_s:.0f} s; {version} is not tried again"
    ),
    NoticeCode.UPDATE_OTHER_PROCESSOR: (
        "no update: {file} is for another kind of processor; this computer takes {here}"
    ),
    NoticeCode.UPDATE_SEVERAL: "no update: there are several packages, {files}; leave one",
    NoticeCode.UPDATE_UNSIGNED: "no update: {file} has no signature beside it that can be read ({signature})",
    NoticeCode.UPDATE_UNKNOWN_KEY: (
        "no update: {file} is signed by {key}, which this computer does not know; its keys are in {folder}"
    ),
    NoticeCode.UPDATE_REVOKED_KEY: (
        "no update: {file} is signed by {key}, which was revoked; take a package that is signed anew"
    ),
    NoticeCode.UPDATE_FORGED: (
        "no update: {file} is not what {key} has signed; copy package and signature anew from where they come"
    ),
    NoticeCode.UPDATE_OLDER: (
        "no update: {file} is older than {newest}, which this computer has had; by hand, `tilth-setup "
        "upgrade` takes it"
    ),
    NoticeCode.UPDATE_NO_ROOM: (
        "no update: {file} needs {needed_mb:.0f} MB on the disk, {free_mb:.0f} MB are free; make room"
    ),
    NoticeCode.UPDATE_UNREADABLE: "no update: {file} could not be read: {why}",
    NoticeCode.UPDATE_REFUSED: "no update: {file} could not be installed: {why}",
    NoticeCode.BACKWARDS: "the tractor goes backwards",
    NoticeCode.BEYOND_BRAKING: "braked with {braking:.1f} m/s²",
    NoticeCode.BEYOND_LATERAL: "{acceleration:.1f} m/s² to the side; the plan allows {limit:g}",
    NoticeCode.BEYOND_WHEELS: "the wheels are at {wheels_deg:.0f}°; the plan allows {limit_deg:g}°",
    NoticeCode.BY_THE_DRIVER: "by the driver",
    NoticeCode.END_NOT_CONFIRMED: "the daemon has not confirmed the mark at its end",
    NoticeCode.END_REFUSED: "the end is not in the log: {why}",
    NoticeCode.FIELD_ENDS: "the field ends here",
    NoticeCode.FOLLOWED_LITTLE: "the wheels followed only {share:.0%} of the bar",
    NoticeCode.NOT_WITH_THE_BAR: "the wheels did not go with the bar: {left:.0%} of it is left over",
    NoticeCode.NO_POSE_FOR: "no pose has come for {silence_s:.1f} s",
    NoticeCode.OFF_THE_BAR: "the wheels were {off_deg:.0f}° off the bar for {off_s:.1f} s",
    NoticeCode.POSE_UNKNOWN: "the tractor's pose is not known",
    NoticeCode.PROMPTER_ENDED: "the prompter was ended",
    NoticeCode.PROMPTER_ENDED_EARLY: "the prompter was ended before the daemon confirmed the mark at its end",
    NoticeCode.RECEIVERS_LOST: "receivers are lost or do not fit: {mounts}",
    NoticeCode.RTK_LOST: "RTK is lost at {mounts}",
    NoticeCode.START_NOT_CONFIRMED: "the daemon has not confirmed the mark at its start",
    NoticeCode.START_REFUSED: "the start is not in the log: {why}",
    NoticeCode.STOPPED: "stopped by the driver",
    NoticeCode.TOO_FAST: "{speed_kmh:.1f} km/h, the run is driven at {wanted_kmh:.1f}",
    NoticeCode.TOO_SLOW: "only {speed_kmh:.1f} km/h, the run is driven at {wanted_kmh:.1f}",
    NoticeCode.WHEELS_NOT_HEARD: "the wheel angle is not heard",
}
LANGUAGES: Final[Mapping[str, Mapping[NoticeCode, Words]]] = {
    ENGLISH: NOTICES,
    GERMAN: german_notices.NOTICES,
}
OR: Final[Mapping[str, str]] = {ENGLISH: " or ", GERMAN: " oder "}
HITCHED: Final[Mapping[str, str]] = {
    ENGLISH: " If another implement is hitched on than the file describes, choose it (`tilth implement`).",
    GERMAN: " Hängt ein anderes Gerät dran, als die Datei beschreibt: dieses wählen (`tilth implement`).",
}
"""Where what contradicts the file is the implement's, or may be."""
_WHILE_DRIVING: Final = frozenset({
    Code.RECEIVER_MOVED, Code.PAIR_TURNED, Code.WHEEL_SLIPPED, Code.DRAWBAR_CHANGED, Code.TYRES_CHANGED,
})  # fmt: skip
"""Then it was the right implement before."""


def notice_sentence(notice: Notice, language: str = ENGLISH) -> str:
    """The notice in words. Raises LookupError, ValueError or TypeError where its values are not those that
    its words need."""
    words = LANGUAGES[language][notice.code]
    if not isinstance(words, str):
        made: Callable[..., str] = words
        return made(**notice.values)
    parts = ", ".join(notice_sentence(part, language) for part in notice.parts)
    reason = sentence(notice.reason, language)
    return words.format(
        **notice.values,
        parts=parts,
        listed=f" ({parts}, 95 %)" if parts else "",
        reason=reason,
        ended=reason if reason.endswith((".", "?", "!")) else f"{reason}.",
        hitched=HITCHED[language] if _of_implement(notice.reason) else "",
        which=OR[language].join(notice.reason.of[1:]) if notice.reason is not None else "",
    )


def _of_implement(reason: Reason | None) -> bool:
    return (
        reason is not None
        and reason.code not in _WHILE_DRIVING
        and any("implement" in key for key in reason.of)
    )


def values_of(code: NoticeCode) -> list[str]:
    """Names of the values that a notice has; a "?" follows one that it may lack."""
    words = NOTICES[code]
    if isinstance(words, str):
        fields = [name for _, name, _, _ in Formatter().parse(words) if name]
        return list(dict.fromkeys(name for name in fields if name not in MADE))
    rows = signature(words).parameters.values()
    return [row.name if row.default is Parameter.empty else f"{row.name}?" for row in rows]


def event_sentence(event: Event, language: str = ENGLISH) -> str:
    """What has happened, in words; of what is the rig's own also where."""
    words = notice_sentence(event.notice, language)
    if event.latitude_deg is None or event.longitude_deg is None or event.notice.code is NoticeCode.TEXT:
        return words
    return f"{words} (at {event.latitude_deg:.6f}, {event.longitude_deg:.6f})"
