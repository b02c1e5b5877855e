"""What distances say of a machine file while the rig stands."""

import pytest
from circle import demo_machine

from tilth.estimator.diagnosis import findings
from tilth.estimator.pose import aligner
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine
from tilth.schemas.sentences import sentence

PAIRS = ("receiver.position on the tractor", "receiver.position on the implement")


def otherwise(mount: Mount, **change: object) -> Machine:
    """The demo's machine file, in which one receiver is told otherwise."""
    machine = demo_machine()
    rows = [r.model_copy(update=change) if r.mount is mount else r for r in machine.receiver]
    return machine.model_copy(update={"receiver": tuple(rows)})


FRONTS = (Mount.TRACTOR_FRONT, Mount.IMPLEMENT_FRONT)


@pytest.mark.parametrize("body", [0, 1])
@pytest.mark.parametrize(
    ("survey_sd", "higher_m", "off_m", "found"),
    [
        (0.02, 0.0, 0.10, False),  # within four times what survey and receivers allow
        (0.02, 0.0, 0.15, True),
        (0.02, 0.0, -0.15, True),
        (0.0, 0.0, 0.10, False),  # slow errors of the positions
        (0.1, 0.0, 0.30, False),  # paced out, and said so
        (0.1, 0.0, 0.50, True),
        (0.02, 1.0, 0.20, False),  # a pair that is pitched by 0.1 rad
        (0.02, 1.0, 0.25, True),
    ],
)
def test_a_pair_of_another_length_is_found_where_the_rig_stands(
    body: int, survey_sd: float, higher_m: float, off_m: float, found: bool
) -> None:
    mount = FRONTS[body]
    (one,) = (r for r in demo_machine().receiver if r.mount is mount)
    forward, right, up = one.position
    machine = otherwise(mount, position=(forward, right, up + higher_m), survey_sd=survey_sd)
    state = aligner.initial(machine)
    for _ in range(findings.FINDINGS.parked_poses):
        state.long_term.parked[body].add(off_m)
    told = findings.parked_errors(machine, state)
    assert [one.key for one in told] == ([PAIRS[body]] if found else [])
    assert all(f"{off_m:+.2f} m while the rig stands still" in sentence(one.reason) for one in told)
