"""What prompts a driver, as one message of plain numbers for panels of Foxglove and Lichtblick."""

import math
from typing import Final

from tilth.schemas.invocation import command
from tilth.schemas.proto import tilth_pb2 as pb

BEYOND: Final = 1.3  # ends of the bar over the run's largest angle, as on the page
LEAST_DEG: Final = 2.0  # the bar is never narrower to either side

WAITS_FOR_NOTHING: Final = pb.ExperimentCondition(name="nothing", met=True, text="it waits for nothing now")
"""In place of an empty list, for which the viewers' table shows an error."""


def prompt_of(state: pb.ExperimentState, t_ns: int) -> pb.ExperimentPrompt:
    """A state of `tilth experiment`, rad, in degrees. t_ns: its time, of the poses' clock."""
    end = max(BEYOND * math.degrees(state.largest), LEAST_DEG)
    return pb.ExperimentPrompt(
        t_ns=t_ns,
        phase=state.phase,
        drive=state.drive,
        text=state.text,
        count=_whole_s(state.count_s) if state.HasField("count_s") else 0,
        wanted_deg=math.degrees(state.wanted) if state.HasField("wanted") else math.nan,
        measured_deg=math.degrees(state.measured) if state.HasField("measured") else math.nan,
        ahead_deg=map(math.degrees, state.ahead),
        left_end_deg=-end,
        right_end_deg=end,
        conditions=state.conditions or [WAITS_FOR_NOTHING],
    )


def nobody_prompts(t_ns: int) -> pb.ExperimentPrompt:
    """What stands there in place of a bar that would stand still."""
    text = f"`{command('experiment')}` is not heard any more: do not follow the bar."
    return prompt_of(pb.ExperimentState(text=text), t_ns)


def _whole_s(count_s: float) -> int:
    """As it is spoken: rounded up. What no countdown can be is none."""
    return math.ceil(count_s) if 0.0 < count_s < 1000.0 else 0
