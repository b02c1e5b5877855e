"""The state of the fold as JSON text and back. A log begins with it, so that one file of a run replays alone.

A text of another version, of other receivers or with a damaged part is refused with a reason. Whoever reads
logs goes on without it. The machine file itself is not in it: the log says of which one its states are.
"""

import json
from typing import Any, Final

from tilth.estimator.fold import State, estimates_now
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.methods.stored_state import consistency_json, consistency_of
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.log_time import LogTime
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.record.record_builder import RecordState
from tilth.estimator.state_json import Stored, to_plain
from tilth.estimator.warm_start import Kept
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Flag
from tilth.schemas.machine import Machine

VERSION: Final = 3
"""Of the text. It goes up by one with every change of what stands in it or of what that means."""


class NotRestorable(ValueError):
    """A stored state that cannot be taken up; a part of a sentence that says why."""


def snapshot(state: State) -> str:
    """The state as JSON text: `restore(machine, snapshot(s))` goes on exactly as `s` would."""
    rows = rows_for(state.machine)
    plain = {
        "version": VERSION,
        "decoder": state.decoder.dump(),
        "aligner": to_plain(state.aligner, skip=frozenset({"machine"})),
        "record": to_plain(state.record),
        "consistency": consistency_json(state.consistency),
        "estimators": {row.method: row.to_json(state.estimators[row.method]) for row in rows},
        "checks": to_plain(state.checks),
        "kept": {method: kept.to_json() for method, kept in state.kept.items()},
        "kept_ns": state.kept_ns,
        "frames": state.frames,
        "measurements": state.measurements,
        "poses": state.poses,
        "ready": state.ready,
        "clock_steps": state.clock_steps,
        "not_numbers": state.not_numbers,
        "time": to_plain(state.time),
        "flags": to_plain(state.flags),
        "place": to_plain(state.place),
        "disagree": to_plain(state.disagree),
    }
    return json.dumps(plain, separators=(",", ":"))


def restore(machine: Machine, text: str) -> State:
    """The state that `snapshot` wrote. Raises NotRestorable."""
    stored = _opened(text)
    try:
        state = _state_of(machine, stored)
        if set(state.aligner.tracks) != {receiver.mount.value for receiver in machine.receiver}:
            raise NotRestorable("it is of a machine with other receivers")
        state.estimates = estimates_now(state)
    except NotRestorable:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise NotRestorable(f"it is damaged: {error}") from None
    return state


def restore_decoder(machine: Machine | None, text: str) -> Decoder:
    """Only what decoding needs: who has which address. Raises NotRestorable.

    Also of another version, as long as this part has stayed what it is. Receivers say who they are only when
    they start: without it nothing would be known of the later files of a run.
    """
    plain = _table(text)
    try:
        return _decoder_of(machine, plain["decoder"])
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise NotRestorable(_other_version(plain) or f"it is damaged: {error}") from None


def _opened(text: str) -> Stored:
    """The parts of a text of this version."""
    plain = _table(text)
    if other := _other_version(plain):
        raise NotRestorable(other)
    del plain["version"]
    return Stored(plain, "the stored state")


def _table(text: str) -> dict[str, Any]:
    try:
        plain = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise NotRestorable(f"it is damaged: {error}") from None
    if not isinstance(plain, dict):
        raise NotRestorable("it is damaged: it is not a table of names and values")
    return plain


def _other_version(plain: dict[str, Any]) -> str:
    """That it is of another version, or ""."""
    version = plain.get("version", "1 or none")
    if version == VERSION:
        return ""
    return f"it is of another version: {version!s:.20}, where this program knows {VERSION}"


def _state_of(machine: Machine, stored: Stored) -> State:
    state = State(
        machine=machine,
        decoder=_decoder_of(machine, stored.plain("decoder")),
        aligner=stored.value(Aligner, "aligner", {"machine": machine}),
        record=stored.value(RecordState, "record"),
        consistency=consistency_of(stored.plain("consistency")),
        estimators=_estimators_of(machine, stored.plain("estimators")),
        checks=stored.value(ReceiverChecks, "checks"),
        kept={method: Kept.from_json(one) for method, one in stored.plain("kept").items()},
        kept_ns=stored.value(int, "kept_ns"),
        frames=stored.value(int, "frames"),
        measurements=stored.value(int, "measurements"),
        poses=stored.value(int, "poses"),
        ready=stored.value(bool, "ready"),
        clock_steps=stored.value(int, "clock_steps"),
        not_numbers=stored.value(int, "not_numbers"),
        time=stored.value(LogTime, "time"),
        flags=tuple(stored.value(list[Flag], "flags")),
        place=stored.maybe(tuple[float, float, float, float], "place"),
        disagree=stored.value(bool, "disagree"),
    )
    stored.end()
    return state


def _estimators_of(machine: Machine, plain: Any) -> dict[str, Any]:
    """Method -> its state; one that was not asked for when the state was stored is at its beginning."""
    if not isinstance(plain, dict):
        raise ValueError("estimators is not a table of names and values")
    return {
        row.method: row.from_json(plain[row.method]) if row.method in plain else row.initial(machine)
        for row in rows_for(machine)
    }


def _decoder_of(machine: Machine | None, plain: Any) -> Decoder:
    decoder = Decoder(machine)
    decoder.load(plain)
    return decoder
