"""What the operator has accepted: values that the watch found, in place of those of the machine file."""

from collections.abc import Iterable

from tilth.estimator.rig.adjustments import Amount
from tilth.estimator.rig.numbers import DRAWBAR, HYPOTHESIS, WHEEL, WHEEL_SPEED, changed
from tilth.schemas.flow import Accepted
from tilth.schemas.machine import Machine, Receiver
from tilth.schemas.notices import Notice, NoticeCode, reasoned
from tilth.schemas.reasons import Reason


def corrected(machine: Machine, accepted: Iterable[Accepted]) -> Machine:
    """The machine file with the accepted values. Raises ValueError for what it does not have."""
    for one in accepted:
        machine = changed(machine, _amounts(one))
    return machine


def _amounts(one: Accepted) -> dict[str, Amount]:
    """By number of the rig. One sd holds for all that changes together."""
    row = HYPOTHESIS.get(one.what)
    if row is None or row.absorbed:
        raise ValueError(f"{one.what} is nothing that can be accepted")
    amounts = [Amount(row.sign * by) for by in one.amounts]
    amounts[0] = amounts[0]._replace(sd=max(one.sds[: len(row.numbers)]), besides=True)
    return dict(zip(row.numbers, amounts, strict=False))


def line_of(machine: Machine, what: str) -> str:
    """What to write into the machine file, with the values that `machine` has."""
    if what == WHEEL:
        zero = machine.wheel_angle.zero
        return f"[wheel_angle] zero = {{ value = {zero.value:.2f}, sd = {zero.sd:.2f} }}"
    factor = machine.tractor.wheel_speed_factor
    if what == WHEEL_SPEED and factor is not None:
        return f"[tractor] wheel_speed_factor = {{ value = {factor.value:.4f}, sd = {factor.sd:.4f} }}"
    if what == DRAWBAR:
        d = machine.implement.d
        return f"[implement] d = {{ value = {d.value:.3f}, sd = {d.sd:.3f} }}"
    moved = [r for r in machine.receiver if what in (r.mount.value, f"pair_{r.mount.body}")]
    return "; ".join(map(_receiver_line, moved))


def _receiver_line(receiver: Receiver) -> str:
    position = ", ".join(f"{x:.3f}" for x in receiver.position)
    return f"{receiver.mount.value} position = [{position}], survey_sd = {receiver.survey_sd:.3f}"


def acceptance(machine: Machine, accepted: Accepted) -> Notice:
    """For the event; machine: with the value."""
    row = HYPOTHESIS[accepted.what]
    what = Reason(row.code, (row.key, row.name), (*accepted.amounts, *accepted.sds))
    return reasoned(what, NoticeCode.ACCEPTED, line=line_of(machine, accepted.what))
