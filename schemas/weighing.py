"""A scale on the implement that a DBC file describes: compiled, and doubts about it.

mass = raw * scale + offset             kg
"""

from collections.abc import Iterator
from typing import Final

from tilth.schemas.can_signal import CanSignal, DbcSignal, dbc_signal, no_data
from tilth.schemas.limits import Doubt
from tilth.schemas.machine import Machine, MachineError, Weighing

SECTION: Final = "implement.load.weighing"
UNITS: Final = {"kg": 1.0, "t": 1e3, "lb": 0.45359237, "lbs": 0.45359237}
COARSEST: Final = 0.1  # of a full load, per bit: no scale is so coarse
FRAME: Final = 8  # bytes of classic CAN


def compile_weighing(machine: Machine) -> CanSignal | None:
    """The scale of a machine file, in kg; None where it describes none. Raises MachineError where its DBC
    file does not give the signal."""
    given = machine.weighing
    if given is None:
        return None
    found = dbc_signal(SECTION, given.dbc, given.dbc_text, given.signal, given.mask)
    factor = _kg_per_unit(given, found)
    empty = no_data(SECTION, given.not_available)
    if given.not_available is None and not found.bits.signed:
        top = (1 << found.bits.bits) - 1  # as J1939 and ISOBUS have it
        empty = top, top
    return CanSignal(
        given.bus, found.can_id & found.mask, found.mask, found.extended, found.bits,
        found.scale * factor, found.offset * factor + given.offset, empty,
    )  # fmt: skip


def _kg_per_unit(given: Weighing, found: DbcSignal) -> float:
    if given.scale is not None:
        return given.scale
    if (factor := UNITS.get(found.unit.strip().lower())) is not None:
        return factor
    unit = f'is in "{found.unit}"' if found.unit else "has no unit"
    raise MachineError(
        f'{SECTION}.signal = "{given.signal}": {unit} in {given.dbc}, which is not kg, t or lb; give '
        f"{SECTION}.scale in kg per unit of the signal"
    )


def weighing_doubts(machine: Machine) -> Iterator[Doubt]:
    """Doubts about the scale: place in the frame, what it can tell."""
    given, load = machine.weighing, machine.implement.load
    if given is None or load is None or given.dbc_text is None:
        return  # a text alone: who opens files brings it along
    try:
        signal = compile_weighing(machine)
    except MachineError as error:
        yield Doubt(str(error), True)
        return
    assert signal is not None
    if signal.bits.size > FRAME:
        yield Doubt(
            f'{SECTION}.signal = "{given.signal}": its field ends in byte {signal.bits.size - 1}, a frame '
            f"has bytes 0 to {FRAME - 1}; correct {given.dbc}",
            True,
        )
        return
    full = load.mass.value + (machine.implement.mass.value if given.weighs == "whole" else 0.0)
    bits = signal.bits.bits - signal.bits.signed
    most = ((1 << bits) - 1) * signal.scale + signal.offset
    check = f"check its unit in {given.dbc}, or give {SECTION}.scale in kg per unit"
    if most < full:
        text = f"its {signal.bits.bits} bits tell {most:,.0f} kg at most, a full one has {full:,.0f} kg"
        yield Doubt(f'{SECTION}.signal = "{given.signal}": {text}; {check}', True)
    elif abs(signal.scale) > COARSEST * load.mass.value:
        text = f"a bit of it is {abs(signal.scale):,.0f} kg, a full load {load.mass.value:,.0f} kg"
        yield Doubt(f'{SECTION}.signal = "{given.signal}": {text}; {check}', True)
