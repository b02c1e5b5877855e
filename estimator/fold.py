"""The one fold: a frame in, publications out. Live and replay are two short loops round `step`.

Nothing here may ask whether it runs live: the result is a function of the machine file and the frames in
their order.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from tilth.schemas.channels import TOPIC_OF
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Estimate, Frame, Pose, Publication
from tilth.schemas.machine import Machine


@dataclass(slots=True)
class State:
    """All that the fold remembers. `step` changes it in place; nobody else does."""

    machine: Machine
    decoder: Decoder
    frames: int = 0
    measurements: int = 0
    poses: int = 0
    rejected: dict[str, int] = field(default_factory=dict)  # reason -> count, of every layer
    last_pose: Pose | None = None
    estimates: dict[str, Estimate] = field(default_factory=dict)  # method -> the latest
    started: Callable[[], None] | None = None


def initial(machine: Machine) -> State:
    """The state before the first frame."""
    return State(machine, Decoder(machine))


def step(state: State, frame: Frame) -> list[Publication]:
    """Take one frame: change the state in place, return what is to be published, in order."""
    state.frames += 1
    out: list[Publication] = []
    for measurement in state.decoder.measurements(frame):
        state.measurements += 1
        out.append(Publication(frame.t_ns, TOPIC_OF[type(measurement)], measurement))
    return out


def snapshot(state: State) -> str:
    """The state as JSON text: `restore(machine, snapshot(s))` goes on exactly as `s` would."""
    raise NotImplementedError


def restore(machine: Machine, text: str) -> State:
    """The state that `snapshot` wrote. Raises ValueError where the text is not such a state."""
    raise NotImplementedError
