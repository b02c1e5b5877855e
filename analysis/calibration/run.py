"""Logs in, what the drive tells out: measurements, calibration, verdict and the machine file's new text."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from tilth.analysis.calibration.machine_text import difference, from_to, rewritten
from tilth.analysis.calibration.reading import LogHeard, read
from tilth.estimator.calibration import faults as finding
from tilth.estimator.calibration import receivers
from tilth.estimator.calibration.calibrate import (
    Calibration,
    CannotCalibrate,
    calibrate,
    tractor_motion,
)
from tilth.estimator.calibration.calibrated_file import calibrated_machine
from tilth.estimator.calibration.changes import Changes, wheel_after
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.faults import RigFault
from tilth.estimator.calibration.receivers import ReceiverRow
from tilth.estimator.calibration.sought_numbers import NOT_BY_DRIVING
from tilth.estimator.calibration.steering_response import SteeringResponse, respond
from tilth.estimator.calibration.verdict import (
    IDENTIFIED,
    NOT_IDENTIFIABLE,
    WEAKLY_IDENTIFIED,
    NumberVerdict,
    RigVerdict,
    verdict,
)
from tilth.replay.readers.rig import Say
from tilth.replay.simulated import SAID, simulated_by
from tilth.replay.wheel_by_way import find, reading_as
from tilth.schemas.flow import WheelAngle
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable
from tilth.schemas.reasons import Reason
from tilth.schemas.sentences import sentence
from tilth.schemas.spread import plus_minus

Progress = Callable[[str, float], None]

READING: Final = 0.1  # share of the work
MANY: Final = 20  # seconds with positions of a device that the file does not name
STATUS_WORDS: Final = {
    IDENTIFIED: "identified", WEAKLY_IDENTIFIED: "weakly identified", NOT_IDENTIFIABLE: "not identifiable",
}  # fmt: skip
"""For people; JSON and the wire have the status itself."""


@dataclass(frozen=True, slots=True)
class Calibrated:
    """All that `tilth calibrate` shows and writes."""

    machine: Machine  # as it was read
    found: Calibration
    verdict: RigVerdict
    faults: tuple[RigFault, ...]
    notes: tuple[str, ...]
    before: str  # texts of the machine file
    after: str
    when: str  # date of the drive
    logs: tuple[str, ...]
    told: Machine
    receivers: tuple[ReceiverRow, ...]
    steering: SteeringResponse | str  # or why nothing can be told of it

    @property
    def title(self) -> str:
        return f"{self.machine.name}, drive of {self.when}, {self.found.records_s:.0f} s of it used"

    def difference(self, names: tuple[str, str]) -> str:
        """What changes in the machine file. names: of the files before and after."""
        return difference(self.before, self.after, names)

    def rows(self) -> list[tuple[str, ...]]:
        """Of the table of numbers, as texts."""
        written = from_to(self.machine, self.told, _places(self.found))
        zero = math.radians(self.told.wheel_angle.zero.value - self.machine.wheel_angle.zero.value)
        return [_row(_of_the_file(one, zero), written[one.number.name]) for one in self.verdict.numbers]

    def sentences(self) -> list[str]:
        """What a person should know of it."""
        soil = ", ".join(f"{name} ± {196 * part:.1f} %" for name, (_, part) in self.verdict.soil.items())
        return [
            *self.verdict.sentences,
            f"What these numbers leave uncertain of soil and tyres (95 %, of this drive): {soil}.",
            *not_by_driving(),
            *self.notes,
        ]

    @property
    def steering_words(self) -> str:
        """How the wheels follow an automatic steering, a sentence."""
        return self.steering if isinstance(self.steering, str) else self.steering.words

    def as_json(self) -> dict[str, object]:
        """Plain data, SI."""
        return {
            "machine": self.machine.name,
            "drive": self.when,
            "seconds": self.found.records_s,
            "good": self.verdict.good,
            "faults": [{"kind": f.kind, "of": f.of, "text": f.text} for f in self.faults],
            "numbers": [
                {
                    "name": one.number.name, "words": one.number.words, "moved": one.moved, "sd": one.sd,
                    "prior_sd": one.number.prior_sd, "wanted_sd": one.number.wanted_sd, "status": one.status,
                    "halves": one.halves, "p": one.p, "tell": one.why_not,
                }
                for one in self.verdict.numbers
            ],
            "halves": {"chi2": self.verdict.chi2, "dof": self.verdict.dof, "p": self.verdict.p},
            "soil": {
                name: {"log_sd": whole, "log_sd_by_numbers": part}
                for name, (whole, part) in self.verdict.soil.items()
            },
            "residuals": {
                "innovations_over_sd": self.found.fit.residual, "whiteness": self.found.fit.whiteness,
                "hitch_gap_m": self.found.hitch_gap, "outliers": self.found.fit.outliers,
                "rows": self.found.fit.rows,
                "kinds": [
                    {"kind": one.kind.name, "words": one.kind.words, "over_stated": one.ratio,
                     "more": one.more, "text": one.words}
                    for one in self.found.fit.left
                ],
            },
            "not_used": {sentence(Reason(why)): count for why, count in self.found.refused.items()},
            "receivers": [one._asdict() for one in self.receivers],
            "steering": None if isinstance(self.steering, str) else asdict(self.steering),
            "steering_words": self.steering_words,
            "sentences": self.sentences(),
            "machine_file": self.after,
        }  # fmt: skip


def not_by_driving() -> list[str]:
    """What no drive tells, and how it is found, in sentences."""
    return [f"Not by driving: {what}: {how}." for what, how in NOT_BY_DRIVING]


def calibrate_logs(
    paths: Sequence[Path], machine_file: MachineFile, buses: Mapping[str, str], say: Say,
    progress: Progress, *, growing: bool = False,
) -> Calibrated:  # fmt: skip
    """growing: as of `read`. Raises CannotCalibrate, LogError, OSError, MachineError."""

    def reading(done: int, of: int) -> None:
        progress("reading", READING * done / max(of, 1))

    machine, text = machine_file
    heard = read(paths, machine, buses, say, reading, growing=growing)
    faults, others = list[RigFault](), list[str]()
    described = machine

    def later(what: str, share: float) -> None:
        progress(what, READING + (1.0 - READING) * share)

    try:
        found = calibrate(described, heard.measurements, later)
    except CannotCalibrate as error:
        better = reread(machine, heard, error)
        if better is None:
            raise CannotCalibrate(" ".join([f"{error}.", *_notes(heard)]), error.faults) from None
        described, fault, others = better
        faults.append(fault)
        heard = read(paths, described, buses, lambda text: None, lambda done, of: None)
        found = calibrate(described, heard.measurements, later)
    judged = verdict(described, found)
    told = calibrated_machine(described, found, judged)
    when = datetime.fromtimestamp(heard.first_ns * 1e-9, UTC).strftime("%Y-%m-%d")
    places = _places(found)
    after = rewritten(text, machine, told, places, when)
    senders = receivers.HeardReceivers()
    for measurement in heard.measurements:
        receivers.take(senders, measurement)
    names = tuple(readable(path.name) for path in paths)
    return Calibrated(
        machine,
        found,
        judged,
        (*faults, *found.faults),
        (*[f"{SAID.capitalize()}."] * bool(simulated_by(paths)), *others, *_notes(heard)),
        text,
        after,
        when,
        names,
        told,
        receivers.rows(senders, machine, places, told),
        steering(heard, told, found.changes),
    )


def steering(heard: LogHeard, told: Machine, changes: Changes) -> SteeringResponse | str:
    """How the wheels follow commands, or why it is not known; by the wheel angle as the found file reads it.

    changes: from the file that `heard` was read by to `told`.
    """
    angles = [one for one in heard.measurements if isinstance(one, WheelAngle)]
    t = np.array([(one.rx_ns - heard.first_ns) * 1e-9 for one in angles])
    wheel = np.array([wheel_after(one.angle, changes) for one in angles])
    orders = heard.commands.orders(told.tractor.wheelbase, heard.first_ns)
    return respond(orders, t, wheel, told.wheel_angle.delay)


def reread(
    machine: Machine, heard: LogHeard, error: CannotCalibrate
) -> tuple[Machine, RigFault, list[str]] | None:
    """The machine file with the message or word that is the wheel angle, what was wrong, and runners-up.

    None where no message is. Raises CannotCalibrate, which then says what was looked at.
    """
    if not any(fault.kind == finding.WHEEL_UNREAD for fault in error.faults):
        return None
    try:
        found = find(heard.messages, tractor_motion(machine, heard.measurements), machine.wheel_angle)
    except CannotCalibrate:
        return None
    if found.best is None:
        said = "; ".join(found.sentences)
        raise CannotCalibrate(f"{error}; no message goes with the way. {said}".strip(), error.faults)
    other = reading_as(machine, found.best)
    if other.wheel_angle == machine.wheel_angle:
        return None
    same = other.wheel_angle.id is not None and other.wheel_angle.id == machine.wheel_angle.id
    where = "stands elsewhere in its message" if same else "is in another message"
    text = f"the wheel angle {where}: {found.best.words}; it is changed in the file"
    kind = "wheel_byte_order" if same else "wheel_message"
    return other, RigFault(kind, "wheel_angle", text), [f"Wheel angle: {one}." for one in found.sentences]


def _places(found: Calibration) -> dict[str, str]:
    """Mount of each receiver in the file -> where it stands."""
    return {MOUNTS[device].value: MOUNTS[k].value for k, device in enumerate(found.changes.assignment)}


def _notes(heard: LogHeard) -> list[str]:
    many = ", ".join(other.words for _, other in sorted(heard.strangers.items()) if other.count > MANY)
    if not many:
        return []
    if not heard.rig:
        return [f"Positions come from other devices: {many}."]
    return [
        f"Devices that the machine file does not name send positions from this rig, too: {many}. They are "
        "left out."
    ]


def _of_the_file(one: NumberVerdict, zero: float) -> NumberVerdict:
    """The same as it changes the file: the wheel's scale by as much as its reading was too large; its zero,
    rad, with what the scale does to it. What is not identifiable changes nothing there."""
    if one.status == NOT_IDENTIFIABLE:
        return one
    if one.number.name == "wheel_gain":
        sd = one.sd * math.exp(-one.moved)
        halves = None if one.halves is None else (math.expm1(-one.halves[0]), math.expm1(-one.halves[1]))
        return replace(one, moved=math.expm1(-one.moved), sd=sd, halves=halves)
    if one.number.name == "wheel_zero":
        by = zero - one.moved
        halves = None if one.halves is None else (one.halves[0] + by, one.halves[1] + by)
        return replace(one, moved=zero, halves=halves)
    return one


def _row(one: NumberVerdict, written: str) -> tuple[str, ...]:
    """written: what its key in the file goes from and to."""
    number = one.number
    unit, per = number.unit, number.per_unit

    def shown(value: float) -> str:
        return f"{float(f'{value / per:.2g}'):g} {unit}"  # two digits, and 100, not 1e+02

    change = "stays"
    if one.status != NOT_IDENTIFIABLE:
        change = plus_minus(one.moved / per, one.sd / per, unit, bare=True)
    halves = ""
    if one.halves is not None and one.p is not None:
        digits = 3 if unit == "m" else 2
        halves = " / ".join(f"{half / per:.{digits}f}" for half in one.halves)
        halves += "" if one.p >= 0.01 else ", differ"
    return (
        number.words,
        change,
        "" if one.status == NOT_IDENTIFIABLE else written,
        shown(number.prior_sd),
        shown(one.sd),
        shown(number.wanted_sd),
        halves,
        STATUS_WORDS[one.status],
    )
