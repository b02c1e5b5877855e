"""Which sensors are alive: what a person in the cab must see at a glance."""

from dataclasses import dataclass

from tilth.schemas.flow import Fix, FixType, Measurement, Mount, Position, WheelAngle
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb

LOST_NS = 1_500_000_000  # receivers send positions at 5 to 10 Hz, the slowest once a second
FIX_NS = 5_000_000_000  # how long a fix type is believed that came once


@dataclass(slots=True)
class _Heard:
    source: int = -1
    any_ns: int = 0
    data_ns: int = 0
    fix: FixType | None = None
    fix_ns: int = 0
    count: int = 0  # of data since `told_ns`
    told_ns: int = 0
    fault: str = ""
    fault_ns: int = 0


class Sensors:
    """The receivers of the machine file and its wheel-angle sensor."""

    def __init__(self, machine: Machine) -> None:
        self._receivers: dict[Mount, _Heard] = {r.mount: _Heard() for r in machine.receiver}
        self._wheel = _Heard()

    def take(self, measurement: Measurement) -> None:
        if isinstance(measurement, WheelAngle):
            heard = self._wheel
            heard.data_ns = measurement.t_ns
            heard.count += 1
        else:
            mount = measurement.origin.mount
            if mount is None or mount not in self._receivers:
                return
            heard = self._receivers[mount]
            if isinstance(measurement, Position):
                heard.data_ns = measurement.t_ns
                heard.count += 1
            elif isinstance(measurement, Fix):
                heard.fix, heard.fix_ns = measurement.fix, measurement.t_ns
        heard.any_ns = measurement.t_ns
        heard.source = measurement.origin.source

    def receivers(self, t_ns: int) -> list[pb.ReceiverStatus]:
        """Rates are those since the last call."""
        return [_status(heard, t_ns, mount.value) for mount, heard in self._receivers.items()]

    def wheel_angle(self, t_ns: int) -> pb.ReceiverStatus:
        return _status(self._wheel, t_ns, "")


def _status(heard: _Heard, t_ns: int, mount: str) -> pb.ReceiverStatus:
    """Notes when it was asked and what it found: for the next time."""
    status = pb.ReceiverStatus(mount=mount, state=_state(heard, t_ns), source=heard.source)
    if heard.fix is not None and t_ns - heard.fix_ns < FIX_NS:
        status.fix = heard.fix.value
    if heard.data_ns:
        status.age_s = (t_ns - heard.data_ns) * 1e-9
    if t_ns > heard.told_ns > 0:
        status.per_s = heard.count / ((t_ns - heard.told_ns) * 1e-9)
    heard.count, heard.told_ns = 0, t_ns
    if status.state in ("lost", "no_data"):
        heard.fault, heard.fault_ns = status.state, t_ns
    if heard.fault:
        status.fault, status.fault_age_s = heard.fault, (t_ns - heard.fault_ns) * 1e-9
    return status


def _state(heard: _Heard, t_ns: int) -> str:
    if heard.any_ns == 0:
        return "waiting"
    if heard.data_ns and t_ns - heard.data_ns < LOST_NS:
        return "alive"
    return "no_data" if t_ns - heard.any_ns < LOST_NS else "lost"
