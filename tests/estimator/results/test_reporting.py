"""What is said of an estimate."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from logs import MACHINE

from tilth.estimator import fold
from tilth.estimator.filters.unknowns import AT, UNKNOWNS
from tilth.estimator.methods import tracker
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Segment
from tilth.estimator.results.reporting import log_sds_over_masses, per_mass
from tilth.schemas.flow import Pose
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import sentence
from tilth.simulator.drive import drive
from tilth.simulator.scenario import DrivenManoeuvre, Scenario
from tilth.simulator.traffic import traffic

Given = list[tuple[Pose, Segment | None]]


def test_what_is_said_of_other_unknowns_has_room_for_errors_of_the_model() -> None:
    state = tracker.initial(MACHINE)
    state.covariance[6:, 6:] *= 1e-6  # hours of rows
    said = tracker.estimate(state, MACHINE, 1).nuisances
    for name, room in ((row.name, row.model_sd) for row in UNKNOWNS if row.model_sd):
        least = min(room, state.prior_sd[AT[name]])
        assert 0.999 * least <= said[name][1] <= 1.1 * least, name


@given(st.floats(0.01, 0.5), st.floats(0.0, 0.6), st.floats(1e4, 1e6))
def test_what_is_not_known_of_a_mass_is_not_in_the_sd_over_it(own: float, mass: float, value: float) -> None:
    sds = log_sds_over_masses(np.diag([own**2 + mass**2] * 6), [mass**2] * 3)
    assert sds == pytest.approx([own] * 3, abs=1e-7)
    values, said = per_mass(MACHINE, [math.log(value)] * 3, sds, (True, False, True))
    assert values[1] is said[1] is None
    assert values[2] == pytest.approx(value / MACHINE.implement.mass.value)
    assert said[2] == pytest.approx(own * value / MACHINE.implement.mass.value, rel=1e-5)


def guessed(sd: float, factor: float) -> Machine:
    """A file whose owner has not weighed the implement, and has reckoned its inertia from the mass."""
    told = MACHINE.implement
    own = {
        "mass": Quantity(value=told.mass.value * factor, sd=sd * told.mass.value * factor),
        "yaw_inertia": Quantity(
            value=told.yaw_inertia.value * factor, sd=math.hypot(sd, 0.05) * told.yaw_inertia.value * factor
        ),
    }
    return MACHINE.model_copy(update={"implement": told.model_copy(update=own)})


@cache
def driven() -> tuple[Given, float]:
    """(what a method is given over half a minute of steering, true logarithm of C_ai over the mass)."""
    scenario = Scenario(seconds=45.0, steering=DrivenManoeuvre("random"), other_traffic=False)
    truth = drive(MACHINE, 3, scenario.seconds, scenario)
    state, recording = fold.initial(MACHINE), record_builder.initial(MACHINE)
    state.ready = False  # its own estimators are not needed
    given_: Given = []
    for frame in traffic(MACHINE, truth):
        for publication in fold.step(state, frame):
            if isinstance(pose := publication.value, Pose):
                given_.append((pose, record_builder.observe(recording, state.aligner, pose)))
    return given_, math.log(truth.parameters["C_ai"] / truth.rig.m_i)


@pytest.mark.parametrize(("sd", "factor"), [(0.1, 1.1), (0.1, 0.9), (0.5, 1.5), (0.5, 0.67)])
def test_c_over_the_mass_holds_whatever_is_told_of_the_mass(sd: float, factor: float) -> None:
    """C_ai itself only as far as the mass is known: with 50 % there is none, and the reason is the mass."""
    given_, true = driven()
    machine = guessed(sd, factor)
    state = tracker.initial(machine)
    for pose, segment in given_:
        tracker.take(state, machine, pose, segment)
    said = tracker.estimate(state, machine, given_[-1][0].t_ns)
    ratio, ratio_sd, c_ai = said.per_mass[2], said.per_mass_sd[2], said.parameters[2]
    assert ratio is not None and ratio_sd is not None and ratio_sd < 0.2 * ratio
    assert abs(math.log(ratio) - true) < 2.5 * ratio_sd / ratio
    if sd < 0.2:
        assert c_ai.value is not None and c_ai.sd is not None
        assert sd < c_ai.sd / c_ai.value < math.hypot(sd, ratio_sd / ratio) + 1e-3
    else:
        assert c_ai.value is None and c_ai.reason is not None
        assert (c_ai.reason.code, c_ai.reason.of) == (Code.OF_THE_MASS, ("implement.mass",))
        assert "weigh it" in sentence(c_ai.reason)
