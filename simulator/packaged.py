"""The rig that the package describes: what is driven if nothing else is said."""

from functools import cache
from importlib import resources

from tilth.schemas.machine_toml import MachineFile, parse_machine


@cache
def packaged_file() -> MachineFile:
    """Its machine file."""
    file = resources.files("tilth.deploy").joinpath("machines/jd7930-parker500.toml")
    text = file.read_text(encoding="utf-8")
    return MachineFile(parse_machine(text), text)
