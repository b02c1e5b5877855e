"""The state of the fold as JSON text and back. Each log file begins with it, so that the file replays alone.

A text of another version, of other receivers or with a damaged part is refused with a reason; readers of logs
then continue without it. The machine file is not part of the text: the log holds it separately.
"""

import json
from typing import Any, Final

from tilth.estimator.fold import State, estimates_now
from tilth.estimator.methods.consistency import Consistency
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.log_time import LogTime
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.pose.recognition import Recognition
from tilth.estimator.pose.standing import StandingCheck
from tilth.estimator.record.record_builder import RecordState
from tilth.estimator.state_json import Stored, to_json_data
from tilth.estimator.warm_start import SavedPosterior
from tilth.estimator.watch.accepted import corrected
from tilth.estimator.watch.watch import WatchState
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Accepted, Flag
from tilth.schemas.machine import Machine

VERSION: Final = 22
"""Version of the text. Raise it by one with every change of the contents or of their meaning."""


class NotRestorable(ValueError):
    """A stored state that cannot be restored. The message is part of a sentence that says why."""


def snapshot(state: State) -> str:
    """The state as JSON text: `restore(machine, snapshot(s))` continues exactly as `s` would."""
    rows = rows_for(state.machine)
    raw = {
        "version": VERSION,
        "decoder": state.decoder.dump(),
        "aligner": to_json_data(state.aligner, skip=frozenset({"machine"})),
        "record": to_json_data(state.record),
        "consistency": to_json_data(state.consistency),
        "estimators": {row.method: to_json_data(state.estimators[row.method]) for row in rows},
        "checks": to_json_data(state.checks),
        "standing": to_json_data(state.standing),
        "watch": to_json_data(state.watch),
        "accepted": to_json_data(state.accepted),
        "previous_run": to_json_data(state.previous_run),
        "previous_run_ns": state.previous_run_ns,
        "frames": state.frames,
        "measurements": state.measurements,
        "poses": state.poses,
        "ready": state.ready,
        "clock_steps": state.clock_steps,
        "not_numbers": state.not_numbers,
        "recognition": to_json_data(state.recognition),
        "time": to_json_data(state.time),
        "flags": to_json_data(state.flags),
        "flag_times": to_json_data(state.flag_times),
        "place": to_json_data(state.place),
        "disagree": to_json_data(state.disagree),
    }
    return json.dumps(raw, separators=(",", ":"))


def restore(machine: Machine, text: str) -> State:
    """The state that `snapshot` wrote. Raises NotRestorable."""
    stored = _parse_current(text)
    try:
        accepted = stored.value(list[Accepted], "accepted")
        state = _state_of(corrected(machine, accepted), stored)
        state.accepted = accepted
        if set(state.aligner.tracks) != {receiver.mount.value for receiver in machine.receiver}:
            raise NotRestorable("it is of a machine with other receivers")
        state.estimates = estimates_now(state)
    except NotRestorable:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise NotRestorable(f"it is damaged: {error}") from None
    return state


def restore_decoder(machine: Machine | None, text: str) -> Decoder:
    """Only the decoder's part: which device has which address. Raises NotRestorable.

    It is also read from a text of another version, if this part has not changed. Receivers claim their
    address only when they start: without this part the senders in the later files of a run would be unknown.
    """
    raw = _parse(text)
    try:
        return _decoder_of(machine, raw["decoder"])
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise NotRestorable(_other_version(raw) or f"it is damaged: {error}") from None


def _parse_current(text: str) -> Stored:
    """The parts of a text of the current version."""
    raw = _parse(text)
    if other := _other_version(raw):
        raise NotRestorable(other)
    del raw["version"]
    return Stored(raw, "the stored state")


def _parse(text: str) -> dict[str, Any]:
    try:
        raw = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise NotRestorable(f"it is damaged: {error}") from None
    if not isinstance(raw, dict):
        raise NotRestorable("it is damaged: it is not a table of names and values")
    return raw


def _other_version(raw: dict[str, Any]) -> str:
    """A message if the text is of another version, else ""."""
    version = raw.get("version", "1 or none")
    if version == VERSION:
        return ""
    return f"it is of another version: {version!s:.20}, where this program knows {VERSION}"


def _state_of(machine: Machine, stored: Stored) -> State:
    state = State(
        machine=machine,
        decoder=_decoder_of(machine, stored.raw("decoder")),
        aligner=stored.value(Aligner, "aligner", {"machine": machine}),
        record=stored.value(RecordState, "record"),
        consistency=stored.value(Consistency, "consistency"),
        estimators=_estimators_of(machine, stored.raw("estimators")),
        checks=stored.value(ReceiverChecks, "checks"),
        standing=stored.value(StandingCheck, "standing"),
        watch=stored.value(WatchState, "watch"),
        previous_run=stored.value(dict[str, SavedPosterior], "previous_run"),
        previous_run_ns=stored.value(int, "previous_run_ns"),
        frames=stored.value(int, "frames"),
        measurements=stored.value(int, "measurements"),
        poses=stored.value(int, "poses"),
        ready=stored.value(bool, "ready"),
        clock_steps=stored.value(int, "clock_steps"),
        not_numbers=stored.value(int, "not_numbers"),
        recognition=stored.value(Recognition, "recognition"),
        time=stored.value(LogTime, "time"),
        flags=tuple(stored.value(list[Flag], "flags")),
        flag_times=stored.value(dict[str, int], "flag_times"),
        place=stored.optional(tuple[float, float, float, float], "place"),
        disagree=stored.value(bool, "disagree"),
    )
    stored.end()
    return state


def _estimators_of(machine: Machine, raw: Any) -> dict[str, Any]:
    """Method -> its state; a method that was not enabled when the state was stored starts new."""
    stored = Stored(raw, "estimators")
    return {
        row.method: stored.value(row.state, row.method) if row.method in raw else row.initial(machine)
        for row in rows_for(machine)
    }


def _decoder_of(machine: Machine | None, raw: Any) -> Decoder:
    decoder = Decoder(machine)
    decoder.load(raw)
    return decoder
