"""A live calibration's wires: the daemon's status and a driver's orders in, what is shown out."""

import threading
import time
from typing import Final

import zenoh

from tilth.client.calibration.shown import DRIVING, FINISHING
from tilth.client.link import Link, first_heard
from tilth.client.orders import OrderQueue
from tilth.client.received import Refused, parse
from tilth.schemas.proto import tilth_pb2 as pb

COMPUTE, FINISH = "compute", "finish"
ORDERS: Final = (COMPUTE, FINISH)
ENCODING: Final = f"application/protobuf;{pb.CalibrationState.DESCRIPTOR.full_name}"
SHOWN_S: Final = 2.0  # a live calibration shows two states a second, also where nothing goes on
SILENT_S: Final = 5.0  # without a status, which comes each second
LARGEST_TEXT: Final = 600  # characters


class CalibrationWires:
    """One daemon, below `base`. The session is closed with it."""

    def __init__(self, session: zenoh.Session, base: str) -> None:
        self._session, self._base, self._link = session, base, Link(session)
        self._lock = threading.Lock()
        self._status: pb.Status | None = None
        self._heard_s = time.monotonic()
        self._logs: dict[str, None] = {}
        self._orders = OrderQueue(pb.CalibrationOrder, ORDERS, session)
        self._link.hear(session.declare_subscriber(f"{base}/status"), self._take_status)
        self._link.hear(session.declare_queryable(f"{base}/calibration/order"), self._orders.take)

    @property
    def logs(self) -> tuple[str, ...]:
        """Paths of the files that the daemon has named, in their order, on its own computer."""
        with self._lock:
            return tuple(self._logs)

    @property
    def trouble(self) -> str:
        """Why the daemon's log does not grow, in a sentence; "" where it should."""
        with self._lock:
            status, silent_s = self._status, time.monotonic() - self._heard_s
        if silent_s > SILENT_S:
            return (
                f"The daemon has been silent for {silent_s:.0f} s; start it again, what was driven is kept."
            )
        if status is None:
            return ""
        if status.resting:
            return "The ignition is off, and the daemon rests; it goes on with the next message of a bus."
        if not status.recording:
            why = status.problems[0] if status.problems else "look at its own line"
            return f"The daemon does not record: {why}"[:LARGEST_TEXT]
        return ""

    def orders(self) -> list[str]:
        """Those since the last call."""
        return self._orders.new()

    def show(self, state: pb.CalibrationState) -> None:
        self._session.put(f"{self._base}/calibration", state.SerializeToString(), encoding=ENCODING)

    def close(self) -> None:
        self._link.close()

    # What follows runs in a thread that hears.

    def _take_status(self, sample: zenoh.Sample) -> None:
        try:
            status = parse(pb.Status, sample.payload.to_bytes(), str(sample.encoding))
        except Refused:
            return  # silence says it soon enough
        with self._lock:
            self._status, self._heard_s = status, time.monotonic()
            if status.log_file:
                self._logs[status.log_file] = None


def calibrates_already(session: zenoh.Session, base: str) -> bool:
    """Whether another live calibration of this machine is at work just now. Takes SHOWN_S where none is."""

    def at_work(sample: zenoh.Sample) -> bool | None:
        state = parse(pb.CalibrationState, sample.payload.to_bytes(), str(sample.encoding))
        return state.phase in (DRIVING, FINISHING) or None

    return first_heard(session, f"{base}/calibration", at_work, SHOWN_S) is not None
