"""All open parts of one run, and the status and summary made from them."""

from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from tilth.logger.can.buses import Buses
from tilth.logger.clock import Clock
from tilth.logger.fold_orders import ACCEPT, LOAD, FoldOrders
from tilth.logger.hitched import KEY as IMPLEMENT
from tilth.logger.hitched import Hitched
from tilth.logger.live_estimation import LiveEstimation
from tilth.logger.log.marks import KIND as MARK
from tilth.logger.log.software import software
from tilth.logger.mark_log import MarkLog
from tilth.logger.outlets import Outlets
from tilth.logger.run_report import RunReport
from tilth.logger.run_summary import LoopCounts, RunSummary
from tilth.logger.status import bus_status, health_of, log_status, problems_of, rejected
from tilth.logger.supervisor import Supervisor
from tilth.logger.zenoh.liveness import Sensors
from tilth.schemas.channels import carried_message
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.rejections import Rejection


@dataclass(frozen=True, slots=True)
class RunParts:
    clock: Clock
    supervisor: Supervisor
    estimation: LiveEstimation
    buses: Buses
    outlets: Outlets
    marks: MarkLog
    accepts: FoldOrders
    loads: FoldOrders
    hitched: Hitched
    run_report: RunReport
    sensors: Sensors
    counts: LoopCounts

    @property
    def answers(self) -> dict[str, Callable[[zenoh.Query, str], None]]:
        """What takes the orders on each key."""
        return {
            MARK: self.marks.marks.take,
            ACCEPT: self.accepts.requests.take,
            LOAD: self.loads.requests.take,
            IMPLEMENT: self.hitched.requests.take,
            **self.run_report.answers,
        }


def build_status(parts: RunParts, t_ns: int) -> pb.Status:
    """Once a second: rates and the longest turn are those since the last call."""
    estimation, counts, recording = parts.estimation, parts.counts, parts.outlets.recording
    live_buses = parts.buses.live_buses
    status = pb.Status(
        t_ns=t_ns,
        run=recording.run_id,
        version=software()["version"],
        uptime_s=(t_ns - counts.started_ns) * 1e-9,
        frames=counts.frames,
        measurements=estimation.fold.measurements,
        poses=estimation.fold.poses,
        buses=[bus_status(bus, t_ns) for bus in live_buses],
        receivers=parts.sensors.receivers(t_ns),
        wheel_angle=parts.sensors.wheel_angle(t_ns),
        rejected=[pb.Count(reason=reason, count=n) for reason, n in all_rejected(parts).items()],
        preparing=estimation.preparing.text,
        ready_in_s=estimation.preparing.remaining_s,
        implement=parts.hitched.name,
        implements=parts.hitched.rigs if len(parts.hitched.rigs) > 1 else [],
        moved=[pb.Moved(names=names, text=text) for names, text in estimation.fold.moved],
    )
    if (load := estimation.fold.carried(t_ns)) is not None:
        status.load.CopyFrom(carried_message(load))
        status.full_load = estimation.fold.full_load
    log_status(status, recording)
    if estimation.worker.seconds is not None:
        status.fit_s = estimation.worker.seconds
    status.problems.extend(problems_of(status, live_buses, recording, parts.outlets.zenoh_problem))
    status.health = health_of(status)
    status.faults.extend(pb.Count(reason=reason, count=n) for reason, n in _faults(parts).items() if n)
    status.longest_turn_s = counts.take_longest_turn_s()
    return status


def all_rejected(parts: RunParts) -> dict[str, int]:
    """Reason -> count, of all that was not used."""
    other: dict[str, int] = {
        Rejection.STAMP: parts.clock.bad_stamps,
        Rejection.MARK: parts.marks.marks.refused,
        Rejection.ACCEPT: parts.accepts.requests.refused,
        Rejection.LOAD: parts.loads.requests.refused,
        Rejection.IMPLEMENT: parts.hitched.requests.refused,
    }
    return rejected(parts.estimation.fold.rejected, parts.buses.live_buses, other)


def _faults(parts: RunParts) -> dict[str, int]:
    return {
        "not_recorded": parts.outlets.recording.missed,  # frames
        "not_published": parts.outlets.not_published,  # values
        "estimators_failed": parts.estimation.fold.faults,
        "clock_stepped": parts.counts.clock_steps,
        "not_notified": parts.supervisor.failures,  # systemd
    }


def summary_of(parts: RunParts, status: pb.Status) -> RunSummary:
    """status: the last one."""
    fold, counts, recording = parts.estimation.fold, parts.counts, parts.outlets.recording
    return RunSummary(
        started_ns=counts.started_ns,
        ended_ns=parts.clock.t_ns(),
        first_frame_ns=counts.first_frame_ns,
        last_frame_ns=counts.last_frame_ns,
        frames=counts.frames,
        measurements=fold.measurements,
        poses=fold.poses,
        rejected=all_rejected(parts),
        estimates=dict(fold.estimates),
        log_files=tuple(recording.files),
        recorded=recording.frames,
        not_recorded=recording.missed,
        lost=sum(bus.traffic.lost for bus in parts.buses.live_buses),
        bad_stamps=parts.clock.bad_stamps,
        faults=fold.faults,
        problems=tuple(status.problems),
    )
