"""The state of the fold as JSON text and back. Each log file begins with it, so that the file replays alone.

A text of another version, of other receivers or with a damaged part is refused with a reason; readers of logs
then continue without it. The machine file is not part of the text: the log holds it separately.
"""

import json
from typing import Any, Final

from tilth.estimator.diagnosis.accepted import corrected
from tilth.estimator.diagnosis.strange_implement import StrangeImplement, with_found
from tilth.estimator.fold import State, estimates_now
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.models.load import laden
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Accepted, Carried
from tilth.schemas.machine import Machine

VERSION: Final = 33
"""Version of the text. Raise it by one with every change of the contents or of their meaning."""


class NotRestorable(ValueError):
    """A stored state that cannot be restored. The message is part of a sentence that says why."""


def snapshot(state: State) -> str:
    """The state as JSON text: `restore(machine, snapshot(s))` continues exactly as `s` would."""
    raw = {"version": VERSION, "decoder": state.decoder.dump(), **to_json_data(state)}
    return json.dumps(raw, separators=(",", ":"))


def restore(machine: Machine, text: str) -> State:
    """The state that `snapshot` wrote. Raises NotRestorable."""
    raw = _parse(text)
    if other := _other_version(raw):
        raise NotRestorable(other)
    del raw["version"]
    try:
        file = corrected(machine, from_json_data(list[Accepted], raw["accepted"]))
        empty = with_found(file, from_json_data(StrangeImplement, raw["strange"]).used)
        machine = laden(empty, from_json_data(Carried | None, raw["carried"]))
        given = {
            "machine": machine,
            "empty": empty,
            "file": file,
            "decoder": _decoder_of(machine, raw.pop("decoder")),
        }
        state: State = from_json_data(State, raw, given)
        stored = state.estimators  # a method that was not enabled then starts new
        state.estimators = {
            row.method: from_json_data(row.state, stored[row.method])
            if row.method in stored
            else row.initial(machine)
            for row in rows_for(machine)
        }
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


def _decoder_of(machine: Machine | None, raw: Any) -> Decoder:
    decoder = Decoder(machine)
    decoder.load(raw)
    return decoder
