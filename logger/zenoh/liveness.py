"""Tracks which sensors are alive."""

from dataclasses import dataclass
from typing import Final

from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.pose.receiver_lost import LOST
from tilth.schemas.flow import Fix, FixType, Measurement, Mount, Position, WheelAngle
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.states import DeviceState

STARTING_NS: Final = 10_000_000_000
"""A receiver that has just been switched on sends before it has a position: so long that is no fault."""


@dataclass(slots=True)
class _Device:
    """A receiver or the wheel-angle sensor. Times on the log's clock, ns; 0: never."""

    source: int = -1  # J1939 source address
    first_ns: int = 0  # the first measurement of any kind
    any_ns: int = 0  # the latest measurement of any kind
    data_ns: int = 0  # the latest position or angle
    fix: FixType | None = None
    fix_ns: int = 0
    count: int = 0  # of positions or angles since `reported_ns`
    reported_ns: int = 0
    fault: DeviceState | None = None  # the latest state that was none to work with
    fault_ns: int = 0


class Sensors:
    """The receivers of the machine file and its wheel-angle sensor."""

    def __init__(self, machine: Machine) -> None:
        self._receivers: dict[Mount, _Device] = {r.mount: _Device() for r in machine.receiver}
        self._wheel = _Device()

    def take(self, measurement: Measurement) -> None:
        """Take a measurement of a receiver or of the wheel angle; others do not count."""
        if isinstance(measurement, WheelAngle):
            device = self._wheel
            device.data_ns = measurement.t_ns
            device.count += 1
        else:
            mount = measurement.origin.mount
            if mount is None or mount not in self._receivers:
                return
            device = self._receivers[mount]
            if isinstance(measurement, Position):
                device.data_ns = measurement.t_ns
                device.count += 1
            elif isinstance(measurement, Fix):
                device.fix, device.fix_ns = measurement.fix, measurement.t_ns
        device.first_ns = device.first_ns or measurement.t_ns
        device.any_ns = measurement.t_ns
        device.source = measurement.origin.source

    def receivers(self, t_ns: int) -> list[pb.ReceiverStatus]:
        """One row per receiver; rates are those since the last call. t_ns: now."""
        return [_status(device, t_ns, mount.value) for mount, device in self._receivers.items()]

    def wheel_angle(self, t_ns: int) -> pb.ReceiverStatus:
        """As `receivers`, of the wheel-angle sensor."""
        return _status(self._wheel, t_ns, "")


def _status(device: _Device, t_ns: int, mount: str) -> pb.ReceiverStatus:
    """Keeps the time and a fault in `device`: the next call counts from here."""
    state = _state(device, t_ns)
    status = pb.ReceiverStatus(mount=mount, state=state, source=device.source)
    if device.fix is not None and t_ns - device.fix_ns < ALIGNMENT.fix_ns:
        status.fix = device.fix.value
    if device.data_ns:
        status.age_s = (t_ns - device.data_ns) * 1e-9
    if t_ns > device.reported_ns > 0:
        status.per_s = device.count / ((t_ns - device.reported_ns) * 1e-9)
    device.count, device.reported_ns = 0, t_ns
    if state in (DeviceState.LOST, DeviceState.NO_DATA):
        device.fault, device.fault_ns = state, t_ns
    if device.fault is not None:
        status.fault, status.fault_age_s = device.fault, (t_ns - device.fault_ns) * 1e-9
    return status


def _state(device: _Device, t_ns: int) -> DeviceState:
    if device.any_ns == 0:
        return DeviceState.WAITING
    if device.data_ns and t_ns - device.data_ns < LOST.lost_ns:
        return DeviceState.ALIVE
    if not device.data_ns and t_ns - device.first_ns < STARTING_NS:
        return DeviceState.WAITING
    return DeviceState.NO_DATA if t_ns - device.any_ns < LOST.lost_ns else DeviceState.LOST
