"""From the TOML text of a machine file to a Machine that can be a real rig."""

import hashlib
import tomllib
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from pydantic import ValidationError

from tilth.schemas.ballast import as_driven
from tilth.schemas.file_problem import sentence
from tilth.schemas.machine import DBC_BREAK, Machine, MachineError
from tilth.schemas.plausible import refuse_impossible

DBC_SECTIONS: Final = (("wheel_angle",), ("implement", "load", "weighing"))
"""Sections that may name a DBC file, in the order of Machine.dbc_text."""
OF_IMPLEMENT: Final = "[implement], [tyres.implement] and the receivers on the implement"


class MachineFile(NamedTuple):
    """A machine file: what it says, and its own text, as it goes into the log."""

    machine: Machine
    text: str

    @property
    def sha256(self) -> str:
        """Of the text and of those of the DBC files it names: tells whether a snapshot fits."""
        return hashlib.sha256((self.text + (self.machine.dbc_text or "")).encode()).hexdigest()


def parse_machine(text: str, dbc_text: str | None = None, *, plausible: bool = True) -> Machine:
    """Machine from the TOML text of a machine file and the texts of the DBC files it names, if any; ballast
    is counted in.

    dbc_text: as Machine.dbc_text.
    plausible: refuse what cannot be a real rig; not of a file stored in a log that is only to be read.
    Raises MachineError.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MachineError(f"not a TOML file: {error}") from None
    texts = (dbc_text or "").split(DBC_BREAK)
    for keys, own in zip(DBC_SECTIONS, texts, strict=False):
        section = section_of(raw, keys)
        if section is not None and dbc_text is not None:
            section["dbc_text"] = own
    try:
        machine = as_driven(Machine.model_validate(raw))
    except ValidationError as error:
        raise MachineError(sentence(error, raw, Machine)) from None
    if plausible:
        refuse_impossible(machine)
    return machine


def section_of(raw: object, keys: Sequence[str]) -> dict[str, Any] | None:
    """A section of a TOML file that may be wrong; None where it is none."""
    for key in keys:
        raw = raw.get(key) if isinstance(raw, dict) else None
    return raw if isinstance(raw, dict) else None


def joined(tractor: str, implement: str) -> str:
    """The text of a machine file, of the tractor's, which has [implements], and of one of these.

    It is a machine file like one that was written in one piece: a log holds it, and needs no other. Raises
    MachineError.
    """
    one, other = _tables(tractor), _tables(implement)
    if stray := _of_implement(one):
        raise MachineError(
            f"{stray[0]}: a file with [implements] leaves {OF_IMPLEMENT} to the files it names"
        )
    if stray := sorted({f"[{key}]" for key in _leaves(other)} - set(_of_implement(other))):
        raise MachineError(f"{stray[0]}: a file of an implement holds {OF_IMPLEMENT}, and nothing else")
    if not isinstance(section := other.get("implement"), dict) or "name" not in section:
        raise MachineError('implement.name: missing; give name = "…", by which it is told from others')
    text = f"{tractor.rstrip()}\n\n# The implement, of a file of its own:\n\n{implement}"
    expected = one | other
    for key in ("tyres", "receiver"):
        if key in one and key in other:
            expected[key] = one[key] | other[key] if key == "tyres" else [*one[key], *other[key]]
    try:
        if tomllib.loads(text) == expected:
            return text
    except tomllib.TOMLDecodeError:
        pass
    raise MachineError("write each part as a table under a [heading], not in { } on one line")


def _tables(text: str) -> dict[str, Any]:
    """Raises MachineError."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MachineError(f"not a TOML file: {error}") from None


def _leaves(raw: dict[str, Any]) -> list[str]:
    """What a file holds, its tyres by the axle and its receivers by the mount."""
    tyres, receivers = raw.get("tyres", {}), raw.get("receiver", [])
    return [
        *(key for key in raw if key not in ("tyres", "receiver")),
        *(f"tyres.{axle}" for axle in (tyres if isinstance(tyres, dict) else [""])),
        *(f"receiver {one.get('mount', '')}" for one in receivers if isinstance(one, dict)),
    ]


def _of_implement(raw: dict[str, Any]) -> list[str]:
    return [
        f"[{key}]" for key in _leaves(raw)
        if key in ("implement", "tyres.implement") or key.startswith("receiver implement")
    ]  # fmt: skip
