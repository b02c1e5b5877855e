"""Makes a machine file of what is heard and of what a person without an editor answers: tape, scale, papers.

Answers are texts, by the names of their fields, such as "tractor.mass"; numbers may have a decimal comma.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from tilth.replay.discover import BusDevice, Findings
from tilth.replay.machine_draft import draft, filled_in, toml_quantity, toml_text
from tilth.replay.wheel_search import WheelCandidate
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Bus, Machine, MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import doubts
from tilth.schemas.quantity import Quantity
from tilth.schemas.rule_of_thumb import (
    CG_OVER_WHEELBASE,
    FRONT_SHARE,
    IMPLEMENT_CG_HEIGHT,
    TONGUE_SHARE,
    BodyWeight,
    TapedLengths,
    by_shares,
    weighed,
)
from tilth.schemas.wheel_angle import RUDDER

TAPED: Final[Mapping[str, float]] = {"tape": 0.02, "sheet": 0.05, "paced": 0.15}
"""How a length is known -> its sd, m."""
WEIGHED: Final[Mapping[str, float]] = {"scale": 0.01, "sheet": 0.05, "guess": 0.15}
"""How a mass is known -> its sd, of it."""
STOPS_SD: Final = 2.0  # degrees: how far from the middle between its stops the wheels may stand straight
STOPS_GAIN_SD: Final = 0.1
FEWEST_STEPS: Final = 16  # of the word, from stop to stop
FIRST: Final = "# Made by `tilth setup`, of what was heard, measured and weighed.\n"


class JudgedAnswer(NamedTuple):
    """What is wrong with an answer, or rare. field: "" where no single one is meant."""

    field: str
    text: str
    refused: bool


@dataclass(slots=True)
class _Form:
    """Reads answers, and notes what is wrong with them."""

    answers: Mapping[str, str]
    wrong: list[JudgedAnswer] = field(default_factory=list)

    def text(self, name: str) -> str:
        return self.answers.get(name, "").strip()

    def refuse(self, name: str, text: str) -> None:
        self.wrong.append(JudgedAnswer(name, text, True))

    def optional(self, name: str) -> float | None:
        """None where nothing was written."""
        return self.number(name) if self.text(name) else None

    def number(self, name: str) -> float:
        """1 where there is none, which then is told of."""
        try:
            found = float(self.text(name).replace(",", "."))
        except ValueError:
            found = math.nan
        if math.isfinite(found):
            return found
        said = self.text(name)
        self.refuse(name, f"“{said[:40]}” is no number" if said else "write a number")
        return 1.0

    def positive(self, name: str) -> float:
        found = self.number(name)
        if found > 0:
            return found
        self.refuse(name, f"{found:g}: must be above zero")
        return 1.0

    def chosen(self, name: str, of: Mapping[str, float]) -> float:
        """By the word of how it is known."""
        if (word := self.text(name)) not in of:
            self.refuse(name, f"choose one of {', '.join(of)}")
            return next(iter(of.values()))
        return of[word]


def machine_text(
    answers: Mapping[str, str], findings: Findings, buses: Sequence[Bus]
) -> tuple[str, list[JudgedAnswer]]:
    """The machine file, and what is wrong or rare: the text is whole where nothing of it is refused."""
    form = _Form(answers)
    values: dict[str, dict[str, tuple[str, str]]] = {"machine": {"name": (toml_text(form.text("name")), "")}}
    if not form.text("name"):
        form.refuse("name", "write a name; letters, digits, - and _")
    sections = _bodies(form)
    for section, keys in sections.items():
        values[section] = {
            key: (toml_quantity(found), "by rule of thumb" if key == "yaw_inertia" else "")
            for key, found in keys.items()
        }
    receivers = _mounted(form, findings)
    if not receivers:
        form.refuse("receivers", "say of at least one receiver where it is mounted")
    for i, (number, device) in enumerate(receivers):
        behind = sections["tractor"]["b"] if _body(form, number) == "tractor" else sections["implement"]["e"]
        values[f"receiver.{i}"] = _receiver(form, number, device, behind.value)
    wheel = _wheel(form, findings)
    if wheel is not None:
        values["wheel_angle"] = _wheel_values(form, wheel)
    if form.wrong:
        return "", form.wrong
    chosen = replace(
        findings,
        sources=tuple(device for _, device in receivers),
        wheel_angles=() if wheel is None else (wheel,),
        buses=tuple(bus.name for bus in buses if bus.name in findings.buses),
    )
    text = filled_in(FIRST + draft(chosen, buses).partition("\n")[2], values)
    return text, _judged(text, [number for number, _ in receivers])


def _bodies(form: _Form) -> dict[str, dict[str, Quantity]]:
    """Of [tractor] and [implement] all that is asked for."""
    names = ("tractor.wheelbase", "tractor.hitch", "implement.drawbar")
    lengths = TapedLengths(form.positive(names[0]), form.number(names[1]), form.positive(names[2]))
    sds = TapedLengths._make(form.chosen(f"{name}.how", TAPED) for name in names)
    tractor = _weight(form, "tractor.mass", "tractor.front", FRONT_SHARE)
    implement = _weight(form, "implement.mass", "implement.tongue", TONGUE_SHARE)
    found = {section: dict(keys) for section, keys in by_shares(tractor, implement, lengths, sds).items()}
    rule = Quantity(
        value=round(CG_OVER_WHEELBASE.value * lengths.wheelbase, 2),
        sd=round(CG_OVER_WHEELBASE.sd * lengths.wheelbase, 2) or 0.01,
    )
    for section, usual in (("tractor", rule), ("implement", IMPLEMENT_CG_HEIGHT)):
        height = form.optional(f"{section}.cg_height")
        found[section]["cg_height"] = usual if height is None else Quantity(value=height, sd=0.1)
    return found


def _weight(form: _Form, name: str, part: str, usual: Quantity) -> BodyWeight:
    """part: of the field with what stands on the front axle or on the hitch, kg."""
    mass, share_sd = form.positive(name), form.chosen(f"{name}.how", WEIGHED)
    ahead = form.optional(part)
    if ahead is None or any(one.field == name for one in form.wrong):
        return BodyWeight(Quantity(value=mass, sd=share_sd * mass), usual)
    if not 0 < ahead < mass:
        form.refuse(part, f"{ahead:g} kg: it is a part of the {mass:g} kg above")
        return BodyWeight(Quantity(value=mass), usual)
    return weighed(ahead, mass - ahead, share_sd)


def _body(form: _Form, number: int) -> str:
    return form.text(f"receiver.{number}.mount").partition("_")[0]


def _mounted(form: _Form, findings: Findings) -> list[tuple[int, BusDevice]]:
    """The receivers that have a place, each with its number on the page."""
    found = []
    for number, device in enumerate(usable(findings)):
        mount = form.text(f"receiver.{number}.mount")
        if not mount:
            continue
        said = form.text(f"receiver.{number}.who")  # they may have been heard in another order meanwhile
        if mount not in tuple(Mount) or said != who(device):
            form.refuse(f"receiver.{number}.mount", "listen again, and say where this one is mounted")
            continue
        found.append((number, device))
    return found


def usable(findings: Findings) -> list[BusDevice]:
    """The receivers that may be mounted: those that have told a position."""
    return [device for device in findings.receivers if device.positions]


def who(device: BusDevice) -> str:
    """By which a receiver is known on the page."""
    return f"{device.bus} {device.source}" + ("" if device.name is None else f" {device.name:016X}")


def _receiver(form: _Form, number: int, device: BusDevice, behind: float) -> dict[str, tuple[str, str]]:
    """behind: the axle behind the body's CG from which it is measured, m."""
    one = f"receiver.{number}"
    ahead, right, height = (form.number(f"{one}.{part}") for part in ("ahead", "right", "height"))
    sd = form.chosen(f"{one}.how", TAPED)
    maker = form.text(f"{one}.maker")
    corrected = str(form.text(f"{one}.corrected") == "yes").lower()
    return {
        "mount": (toml_text(form.text(f"{one}.mount")), ""),
        "position": (f"[{round(ahead - behind, 3)}, {right:g}, {height:g}]", ""),
        "roll_corrected": (f"{corrected}\nsurvey_sd = {sd:g}", ""),
        **({"manufacturer": (maker if maker.isdecimal() else "", "")} if device.name is None else {}),
    }


def _wheel(form: _Form, findings: Findings) -> WheelCandidate | None:
    said = form.text("wheel")
    for candidate in findings.wheel_angles:
        if said == which(candidate):
            return candidate
    form.refuse("wheel", "choose one; where there is none, turn the wheel while listening")
    return None


def which(candidate: WheelCandidate) -> str:
    """By which a wheel angle is known on the page."""
    return f"{candidate.bus} {candidate.can_id:X} {candidate.start_byte} {candidate.byte_order}"


def _wheel_values(form: _Form, wheel: WheelCandidate) -> dict[str, tuple[str, str]]:
    """With a known scale, or with the angle from stop to stop, which it has just been turned."""
    found: dict[str, tuple[str, str]] = {"offset": ("", "")}
    if form.text("wheel.sign") in ("1", "-1"):
        found["sign"] = (form.text("wheel.sign"), "")
    if wheel.pgn == RUDDER:
        return found
    found["id"] = (f"0x{wheel.can_id:X}", "")
    if form.text("wheel.way") == "stops":
        turned = wheel.highest - wheel.lowest
        if turned < FEWEST_STEPS:
            form.refuse("wheel.stops", "turn the wheel from stop to stop while listening")
            return found
        scale = form.positive("wheel.stops") / turned
        offset = -scale * (wheel.lowest + wheel.highest) / 2
        found["zero"] = (
            f"{{ value = 0.0, sd = {STOPS_SD} }}\n"
            f"gain = {{ value = 1.0, sd = {STOPS_GAIN_SD} }}\noffset = {offset:.6g}", ""
        )  # fmt: skip
    else:
        scale = form.number("wheel.scale")
        if not scale:
            form.refuse("wheel.scale", "0: degrees per bit are not zero")
        if (known := form.optional("wheel.offset")) is not None:
            found["zero"] = (f"{{ value = 0.0, sd = 0.5 }}\noffset = {known:g}", "")
    return found | {"scale": (f"{scale:.6g}", "")}


_FIELDS: Final[Mapping[str, str]] = {
    "machine.name": "name", "tractor.a": "tractor.wheelbase", "tractor.b": "tractor.wheelbase",
    "tractor.c": "tractor.hitch", "tractor.mass": "tractor.mass", "tractor.yaw_inertia": "tractor.mass",
    "tractor.cg_height": "tractor.cg_height", "implement.d": "implement.drawbar",
    "implement.e": "implement.tongue", "implement.mass": "implement.mass",
    "implement.yaw_inertia": "implement.mass", "implement.cg_height": "implement.cg_height",
}  # fmt: skip
"""Key of the machine file -> the field of the page."""


def _judged(text: str, receivers: Sequence[int]) -> list[JudgedAnswer]:
    """What the machine file says of itself. receivers: their numbers on the page, in the file's order."""
    try:
        machine = parse_machine(text, plausible=False)
    except MachineError as error:
        return [JudgedAnswer(_field(str(error), _no_receiver), str(error), True)]
    numbers = {r.mount.value: number for r, number in zip(machine.receiver, receivers, strict=True)}

    def receiver(said: str) -> str:
        mount = said.removeprefix("receiver ").partition(":")[0]
        return f"receiver.{numbers[mount]}.ahead" if mount in numbers else "receivers"

    return list(_doubted(machine, receiver))


def _doubted(machine: Machine, receiver: Callable[[str], str]) -> Iterator[JudgedAnswer]:
    for doubt in doubts(machine):
        yield JudgedAnswer(_field(doubt.text, receiver), doubt.text, doubt.refused)


def _no_receiver(said: str) -> str:
    return "receivers"


def _field(said: str, receiver: Callable[[str], str]) -> str:
    if said.startswith("receiver"):
        return receiver(said)
    key = said.partition(" = ")[0].removesuffix(".sd")
    return _FIELDS.get(key, "wheel.scale" if key.startswith("wheel_angle") else "")
