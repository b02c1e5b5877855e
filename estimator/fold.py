"""The one fold: a frame in, publications out. Live and replay are two short loops round `step`.

Nothing here may ask whether it runs live: the result is a function of the machine file and the frames in
their order.
"""

import json
from dataclasses import dataclass, field, replace
from typing import Any

from tilth.estimator import aligner
from tilth.estimator.aligner import SILENCE_NS, Aligner
from tilth.estimator.estimators import ESTIMATORS
from tilth.estimator.plain import from_plain, to_plain
from tilth.estimator.pose import poses
from tilth.schemas.channels import TOPIC_OF
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Estimate, Event, Frame, Measurement, Pose, Position, Publication
from tilth.schemas.machine import Machine

RECOMMENDED = "recommended"
REWIND_NS = 500_000_000  # time running back further than this: the clock of the log stepped

_FLAG_TEXT = {
    "lost": "gives no usable position",
    "waiting": "has given no position yet",
    "floating": "lost its RTK fix (float)",
    "no_rtk": "has no RTK fix",
    "no_fix": "has no position fix",
    "repeating": "repeats old positions",
    "swapped": "stands in another's place: two receivers are exchanged",
    "moved": "is not where the machine file says",
    "doubtful": "does not fit the rig at this instant",
    "late": "is late; its position is carried on",
    "latency": "reports later than the machine file allows, or was moved along",
    "fix_unknown": "has stopped telling its fix",
}


@dataclass(slots=True)
class State:
    """All that the fold remembers. `step` changes it in place; nobody else does."""

    machine: Machine
    decoder: Decoder
    aligner: Aligner
    estimators: dict[str, Any]  # method -> the state of that row of ESTIMATORS
    frames: int = 0
    measurements: int = 0
    poses: int = 0
    clock_steps: int = 0
    latest_ns: int = 0  # greatest t_ns since the last step back of the clock
    flags: tuple[str, ...] = ()  # of the last pose
    estimates: dict[str, Estimate] = field(default_factory=dict)  # method -> the latest

    @property
    def rejected(self) -> dict[str, int]:
        """Reason -> count, of what was not used."""
        counts = dict(self.decoder.rejected)
        if self.clock_steps:
            counts["clock_step"] = self.clock_steps
        return counts


def initial(machine: Machine) -> State:
    """The state before the first frame."""
    estimators = {row.method: row.initial(machine) for row in ESTIMATORS}
    state = State(machine, Decoder(machine), aligner.initial(machine), estimators)
    state.estimates = _estimates_now(state)
    return state


def _estimates_now(state: State) -> dict[str, Estimate]:
    """Method -> what can be said at this moment; "recommended" beside them."""
    now = {
        row.method: row.estimate(state.estimators[row.method], state.machine, state.latest_ns)
        for row in ESTIMATORS
    }
    return {**now, RECOMMENDED: replace(now[ESTIMATORS[0].method], method=RECOMMENDED)}


def step(state: State, frame: Frame) -> list[Publication]:
    """Take one frame: change the state in place, return what is to be published, in order."""
    out: list[Publication] = []
    if frame.t_ns < state.latest_ns - REWIND_NS:
        _clock_stepped(state, frame, out)
    elif state.latest_ns and frame.t_ns > state.latest_ns + SILENCE_NS:
        seconds = (frame.t_ns - state.latest_ns) * 1e-9
        out.append(
            Publication(frame.t_ns, "/event", Event(frame.t_ns, "gap", f"no frame for {seconds:.1f} s"))
        )
    state.latest_ns = max(frame.t_ns, state.latest_ns)
    state.frames += 1
    placed = False
    for measurement in state.decoder.measurements(frame):
        placed |= _take(state, frame.t_ns, measurement, out)
    due_ns = state.aligner.due_ns
    now_ns = min(frame.rx_ns, frame.t_ns)  # nothing is received later than it is taken
    if due_ns and (placed or now_ns >= due_ns + aligner.DEADLINE_NS):
        for pose in poses(state.aligner, now_ns):
            _pose(state, frame.t_ns, pose, out)
    return out


def _take(state: State, t_ns: int, measurement: Measurement, out: list[Publication]) -> bool:
    """Publish and keep one measurement. Whether it was a position, which may make a pose due."""
    state.measurements += 1
    out.append(Publication(t_ns, TOPIC_OF[type(measurement)], measurement))
    aligner.take(state.aligner, measurement)
    if not isinstance(measurement, Position) or measurement.origin.mount is None:
        return False
    out.append(Publication(t_ns, f"/gnss/{measurement.origin.mount.value}", measurement))
    return True


def _pose(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> None:
    state.poses += 1
    out.append(Publication(t_ns, "/pose", pose))
    for flag in pose.flags:
        kind, _, who = flag.partition(":")
        if flag not in state.flags and kind in _FLAG_TEXT:
            text = "is silent" if who == "wheel_angle" else _FLAG_TEXT[kind]
            out.append(Publication(t_ns, "/event", Event(t_ns, kind, f"{who} {text}")))
    for flag in state.flags:
        kind, _, who = flag.partition(":")
        if flag not in pose.flags and kind in _FLAG_TEXT:
            out.append(Publication(t_ns, "/event", Event(t_ns, kind, f"{who}: over")))
    state.flags = pose.flags
    for row in ESTIMATORS:
        estimate = row.take(state.estimators[row.method], state.machine, pose)
        if estimate is not None:
            _estimate(state, t_ns, estimate, out)


def _estimate(state: State, t_ns: int, estimate: Estimate, out: list[Publication]) -> None:
    state.estimates[estimate.method] = estimate
    out.append(Publication(t_ns, f"/soil_tire/{estimate.method}", estimate))
    if estimate.method == ESTIMATORS[0].method:
        recommended = state.estimates[RECOMMENDED] = replace(estimate, method=RECOMMENDED)
        out.append(Publication(t_ns, "/soil_tire", recommended))


def _clock_stepped(state: State, frame: Frame, out: list[Publication]) -> None:
    """Time ran back: what was kept belongs to another time. What was learned of the soil stays."""
    seconds = (state.latest_ns - frame.t_ns) * 1e-9
    state.clock_steps += 1
    state.aligner = aligner.initial(state.machine)
    for row in ESTIMATORS:
        row.clock_stepped(state.estimators[row.method], frame.t_ns - state.latest_ns)
    state.latest_ns = frame.t_ns
    text = f"the clock of the log stepped back by {seconds:.1f} s; positions are aligned anew"
    out.append(Publication(frame.t_ns, "/event", Event(frame.t_ns, "clock_step", text)))


_REBUILT = frozenset({"machine", "decoder", "estimators", "estimates"})


def snapshot(state: State) -> str:
    """The state as JSON text: `restore(machine, snapshot(s))` goes on exactly as `s` would."""
    plain = to_plain(state, skip=_REBUILT)
    plain["decoder"] = state.decoder.dump()
    plain["estimators"] = {method: to_plain(own) for method, own in state.estimators.items()}
    return json.dumps(plain, separators=(",", ":"))


def restore(machine: Machine, text: str) -> State:
    """The state that `snapshot` wrote. Raises ValueError where the text is not such a state."""
    plain = json.loads(text)
    if not isinstance(plain, dict) or "decoder" not in plain:
        raise ValueError("this is no stored state of the fold")
    decoder = Decoder(machine)
    try:
        decoder.load(plain.pop("decoder"))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"this is no stored state of the decoder: {error}") from None
    stored = plain.pop("estimators", {})
    estimators = {row.method: from_plain(row.state, stored.get(row.method)) for row in ESTIMATORS}
    given = {
        "machine": machine, "decoder": decoder, "estimators": estimators, "estimates": {},
    }  # fmt: skip
    state = from_plain(State, plain, given)
    assert isinstance(state, State)
    if set(state.aligner.tracks) != {receiver.mount.value for receiver in machine.receiver}:
        raise ValueError("this stored state is of a machine with other receivers")
    state.estimates = _estimates_now(state)
    return state
