"""Frames that a busy computer stamped late are told from traffic as it is."""

from dataclasses import replace

import pytest
from circle import demo_machine

from tilth.estimator.fold import initial, step
from tilth.estimator.pose import lateness
from tilth.estimator.pose.lateness import Lateness
from tilth.schemas.flow import PARAMETERS, Estimate, Event, Frame, Status
from tilth.schemas.reasons import Code
from tilth.simulator.drive import drive
from tilth.simulator.scenario import DrivenManoeuvre, Scenario
from tilth.simulator.traffic import simulate

MACHINE = demo_machine()
START_NS = 1_700_000_000_000_000_000


def frame(t_ns: int) -> Frame:
    return Frame(t_ns, t_ns, "can0", 0x18FF0B15, True, False, bytes(8))


def starved(stamps_ns: list[int], from_ns: int, until_ns: int) -> list[int]:
    """What came between the two is stamped at the end, some microseconds apart."""
    out, k = list[int](), 0
    for t_ns in stamps_ns:
        late = from_ns <= t_ns < until_ns
        out.append(until_ns + 3_000 * k if late else max(t_ns, out[-1] if out else 0))
        k += late
    return out


@pytest.mark.parametrize("seconds", [0.1, 0.3, 1.0])
def test_a_starved_bus_is_seen_and_the_time_before_is_doubted(seconds: float) -> None:
    stamps = [START_NS + k * 1_250_000 for k in range(4000)]  # 800 a second, as on a tractor
    begins, ends = START_NS + 2_000_000_000, START_NS + 2_000_000_000 + round(seconds * 1e9)
    state = Lateness()
    for t_ns in starved(stamps, begins, ends):
        lateness.take_frame(state, MACHINE, frame(t_ns))
    assert (
        0.7 * seconds * 800 < state.late <= seconds * 800 + 3
    )  # a few that the bus could not carry so soon after
    assert state.doubts(begins) and state.doubts(ends) and not state.doubts(begins - 10_000_000)
    assert not state.doubts(ends + lateness.LATENESS.doubt_ns + 10_000_000)


@pytest.mark.parametrize("hertz", [10, 20, 50, 100])
def test_late_readings_of_the_wheel_angle_alone_are_seen(hertz: int) -> None:
    stamps = [START_NS + k * 1_000_000_000 // hertz for k in range(10 * hertz)]
    begins = START_NS + 5_000_000_000
    state = Lateness()
    for t_ns in starved(stamps, begins, begins + 500_000_000):
        lateness.take_wheel(state, t_ns)
    assert state.late >= 0.4 * hertz - 2 and state.doubts(begins + 250_000_000)


@pytest.mark.parametrize("batch_ms", [1, 8, 16])
def test_adapters_that_report_in_batches_are_not_late(batch_ms: int) -> None:
    state, batch = Lateness(), batch_ms * 1_000_000
    for k in range(4000):
        lateness.take_frame(state, MACHINE, frame(START_NS + k * 1_250_000 // batch * batch))
    for k in range(1000):
        lateness.take_wheel(state, START_NS + k * 10_000_000 // batch * batch)
    assert state.late == 0


def test_bursts_of_receivers_and_silences_of_a_quiet_bus_are_not_late() -> None:
    state = Lateness()
    for epoch in range(100):
        for k in range(24):  # four receivers at once, as fast as the bus carries them
            lateness.take_frame(state, MACHINE, frame(START_NS + epoch * 200_000_000 + k * 560_000))
    assert state.late == 0


def test_a_busy_computer_is_named_and_the_machine_file_is_not() -> None:
    """All buses starved again and again for 0.15 to 0.5 s, as by a program that takes both cores."""
    scenario = Scenario(steering=DrivenManoeuvre("random"), other_traffic=False)
    given = list(simulate(MACHINE, 3, 45.0, scenario))
    first_ns, k = given[0].t_ns, 0
    events, last = list[Event](), None
    spans = [(20.0, 20.3), (24.0, 24.15), (29.0, 29.5), (33.0, 33.3), (40.0, 40.2)]
    state = initial(MACHINE)
    for one in given:
        seconds = (one.t_ns - first_ns) * 1e-9
        k += k < len(spans) - 1 and seconds >= spans[k][1]
        if spans[k][0] <= seconds < spans[k][1]:
            stamp_ns = first_ns + round(spans[k][1] * 1e9)
            one = replace(one, t_ns=stamp_ns, rx_ns=stamp_ns)
        for publication in step(state, one):
            if isinstance(publication.value, Event):
                events.append(publication.value)
            elif isinstance(publication.value, Estimate) and publication.value.method == "tracker":
                last = publication.value
    kinds = [event.kind for event in events]
    assert kinds.count("late_frames") >= len(spans)
    assert not {"contradiction", "soil_change", "moved", "swapped", "spikes", "smoothed_yaw_rate"} & {*kinds}
    assert state.rejected["late"] > 100
    assert state.record.refused[Code.FRAMES_LATE] > 0
    assert last is not None and last.parameters[0].status is Status.ESTIMATED
    truth = drive(MACHINE, 3, 45.0, scenario).parameters
    for parameter, name in zip(last.parameters, PARAMETERS, strict=True):
        assert parameter.value is not None and parameter.sd is not None
        assert abs(parameter.value - truth[name]) < 3.0 * parameter.sd
