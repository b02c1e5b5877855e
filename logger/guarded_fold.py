"""The fold with the one guard round it: whatever goes wrong in the numerics, frames go on being logged.

Live and replay both drive this, so that a replay fails where the live run failed and goes on as it did.
"""

from collections import Counter

from tilth.estimator.fold import RECOMMENDED, State, initial, restore, snapshot, step
from tilth.schemas.channels import CHANNELS, payload
from tilth.schemas.flow import PARAMETERS, Estimate, Event, Frame, ParameterEstimate, Publication, Status
from tilth.schemas.machine import Machine

PAUSE_NS = 1_000_000_000  # of the frames' clock: a fault at every frame must not cost a new start at each
_METHOD_OF = {  # topic -> method, of all channels that carry estimates
    channel.topic: channel.topic.removeprefix("/soil_tire").removeprefix("/") or RECOMMENDED
    for channel in CHANNELS
    if channel.topic.startswith("/soil_tire")
}


class GuardedFold:
    """`take` never raises. After a fault the estimates are published as invalid and the state starts anew."""

    def __init__(self, machine: Machine, state_json: str | None = None) -> None:
        """The fold before the first frame, or as `renew` wrote it. Raises ValueError for another's text."""
        self.state: State = initial(machine) if state_json is None else restore(machine, state_json)
        self.faults = 0
        self.estimates = dict(self.state.estimates)  # method -> the last, also of a fault
        self._machine = machine
        self._resume_ns = 0
        self._counted = Counter[str]()  # of states given up
        self._rejected = Counter[str]()

    @property
    def measurements(self) -> int:
        return self._counted["measurements"] + self.state.measurements

    @property
    def poses(self) -> int:
        return self._counted["poses"] + self.state.poses

    @property
    def rejected(self) -> dict[str, int]:
        """Reason -> count, of what was not used."""
        return dict(self._rejected + Counter(self.state.rejected))

    def take(self, frame: Frame) -> list[tuple[Publication, bytes]]:
        """What a frame causes, with its bytes as logged and published."""
        if frame.t_ns < self._resume_ns:
            return []
        try:
            publications = step(self.state, frame)
            told = [(publication, payload(publication)) for publication in publications]
        except Exception as error:  # the one edge where the fold's errors are caught
            publications = self._start_anew(frame.t_ns, error)
            told = [(publication, payload(publication)) for publication in publications]
        for publication in publications:
            if isinstance(publication.value, Estimate):
                self.estimates[publication.value.method] = publication.value
        return told

    def renew(self) -> str:
        """The state as text; the fold goes on from just that text, so that live is replay by construction."""
        self._resume_ns = 0
        try:
            text = snapshot(self.state)
            self.state = restore(self._machine, text)
        except Exception:  # the same edge: beginning a log file must not end the run; `faults` is shown
            self._give_up()
            text = snapshot(self.state)
        return text

    def _give_up(self) -> None:
        self.faults += 1
        self._counted.update(measurements=self.state.measurements, poses=self.state.poses)
        self._rejected.update(self.state.rejected)
        self.state = initial(self._machine)

    def _start_anew(self, t_ns: int, error: Exception) -> list[Publication]:
        self._give_up()
        self._resume_ns = t_ns + PAUSE_NS
        reason = f"the estimators failed ({type(error).__name__}: {error}) and start again; frames are logged"
        none = tuple(ParameterEstimate(None, None, Status.INVALID, reason) for _ in PARAMETERS)
        publications = [Publication(t_ns, "/event", Event(t_ns, "fault", reason))]
        for topic, method in _METHOD_OF.items():
            publications.append(Publication(t_ns, topic, Estimate(t_ns, method, "", none, (), ())))
        return publications
