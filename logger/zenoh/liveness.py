"""Which sensors are alive: what a person in the cab must see at a glance."""

from dataclasses import dataclass

from tilth.schemas.flow import Fix, FixType, Measurement, Mount, Position, WheelAngle
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb

LOST_NS = 1_500_000_000  # receivers send positions at 5 to 10 Hz, the slowest once a second
FIX_NS = 5_000_000_000  # how long a fix type is believed that came once


@dataclass(slots=True)
class _Device:
    source: int = -1
    any_ns: int = 0
    data_ns: int = 0
    fix: FixType | None = None
    fix_ns: int = 0
    count: int = 0  # of data since `told_ns`
    reported_ns: int = 0
    fault: str = ""
    fault_ns: int = 0


class Sensors:
    """The receivers of the machine file and its wheel-angle sensor."""

    def __init__(self, machine: Machine) -> None:
        self._receivers: dict[Mount, _Device] = {r.mount: _Device() for r in machine.receiver}
        self._wheel = _Device()

    def take(self, measurement: Measurement) -> None:
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
        device.any_ns = measurement.t_ns
        device.source = measurement.origin.source

    def receivers(self, t_ns: int) -> list[pb.ReceiverStatus]:
        """Rates are those since the last call."""
        return [_status(device, t_ns, mount.value) for mount, device in self._receivers.items()]

    def wheel_angle(self, t_ns: int) -> pb.ReceiverStatus:
        return _status(self._wheel, t_ns, "")


def _status(device: _Device, t_ns: int, mount: str) -> pb.ReceiverStatus:
    """Notes when it was asked and what it found: for the next time."""
    status = pb.ReceiverStatus(mount=mount, state=_state(device, t_ns), source=device.source)
    if device.fix is not None and t_ns - device.fix_ns < FIX_NS:
        status.fix = device.fix.value
    if device.data_ns:
        status.age_s = (t_ns - device.data_ns) * 1e-9
    if t_ns > device.reported_ns > 0:
        status.per_s = device.count / ((t_ns - device.reported_ns) * 1e-9)
    device.count, device.reported_ns = 0, t_ns
    if status.state in ("lost", "no_data"):
        device.fault, device.fault_ns = status.state, t_ns
    if device.fault:
        status.fault, status.fault_age_s = device.fault, (t_ns - device.fault_ns) * 1e-9
    return status


def _state(device: _Device, t_ns: int) -> str:
    if device.any_ns == 0:
        return "waiting"
    if device.data_ns and t_ns - device.data_ns < LOST_NS:
        return "alive"
    return "no_data" if t_ns - device.any_ns < LOST_NS else "lost"
