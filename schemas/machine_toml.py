"""From the TOML text of a machine file to a Machine that can be a real rig."""

import hashlib
import tomllib
from typing import NamedTuple

from pydantic import ValidationError

from tilth.schemas.ballast import as_driven
from tilth.schemas.file_problem import sentence
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.plausible import refuse_impossible


class MachineFile(NamedTuple):
    """A machine file: what it says, and its own text, as it goes into the log."""

    machine: Machine
    text: str

    @property
    def sha256(self) -> str:
        """Of the text and of that of the DBC file it names: tells whether a snapshot fits."""
        return hashlib.sha256((self.text + (self.machine.wheel_angle.dbc_text or "")).encode()).hexdigest()


def parse_machine(text: str, dbc_text: str | None = None, *, plausible: bool = True) -> Machine:
    """Machine from the TOML text of a machine file and the text of the DBC file it names, if any; ballast is
    counted in.

    plausible: refuse what cannot be a real rig; not of a file stored in a log that is only to be read.
    Raises MachineError.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MachineError(f"not a TOML file: {error}") from None
    if dbc_text is not None and isinstance(raw.get("wheel_angle"), dict):
        raw["wheel_angle"]["dbc_text"] = dbc_text
    try:
        machine = as_driven(Machine.model_validate(raw))
    except ValidationError as error:
        raise MachineError(sentence(error, raw, Machine)) from None
    if plausible:
        refuse_impossible(machine)
    return machine
