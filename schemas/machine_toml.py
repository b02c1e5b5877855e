"""From the TOML text of a machine file to a Machine that can be a real rig."""

import tomllib

from pydantic import ValidationError

from tilth.schemas.ballast import as_driven
from tilth.schemas.file_problem import sentence
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.plausible import refuse_impossible


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
