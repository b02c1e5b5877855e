"""Lengths that a machine file has wrong are found while driving, and a right file never is."""

import math

import numpy as np
import pytest
from circle import demo_machine

from tilth.estimator.diagnosis import against_file, watch
from tilth.estimator.diagnosis.against_file import AGAINST_FILE
from tilth.estimator.diagnosis.information import DELAY, InformationForm, N, lengths, rows
from tilth.estimator.diagnosis.sample import BodySample, Sample
from tilth.estimator.rig.numbers import DRAWBAR
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import Mount
from tilth.schemas.reasons import Code

MACHINE = demo_machine()
RIG = lengths(MACHINE)
WRONG = {
    "tractor_front": (0.25, 0.0), "tractor_rear": (-0.25, 0.0), "implement_front": (-0.25, 0.0),
    "implement_rear": (0.25, 0.1), DRAWBAR: (0.25,),
}  # fmt: skip
LATE_S = (0.05, -0.04, 0.03, -0.05)
NOISE = 0.4  # of the sd of a pose: the samples that count as one are counted so for errors that last


def driven(
    minutes: float, seed: int = 1, late: tuple[float, ...] = LATE_S, turns: bool = True,
    wrong: tuple[str, tuple[float, ...]] | None = None,
) -> InformationForm:  # fmt: skip
    """Rows of 40 s, and turns of 20 s at half the speed in which the rig folds; what it tells of the file."""
    rng, evidence = np.random.default_rng(seed), InformationForm()
    constants = np.zeros(N)
    constants[DELAY] = late
    if wrong is not None:
        constants += watch.directions_of(MACHINE, wrong[0]) @ np.array(wrong[1])
    for k in range(round(minutes * 300)):
        t_s = k * 0.2 % 60.0
        turning = turns and t_s > 40.0
        u, r = (1.9, 0.3) if turning else (3.5, rng.normal(0.0, 0.02))
        folded = 0.5 * math.sin((t_s - 40.0) / 20.0 * math.pi) if turning else 0.0
        body = BodySample(0.0, 0.0, u, 0.0, r, 0.02 * math.sin(t_s / 7.0), (0.0, 0.0))
        tractor = BodySample(folded, 0.0, u, 0.0, r, body.roll, (0.0, 0.0))
        kinds, design, _ = rows(RIG, Sample(tractor, body, (0.0, 0.0), 0.0))
        measured = design @ constants + rng.normal(0.0, NOISE * RIG.sds[kinds])
        weighted = design.T / (RIG.sds**2 * RIG.correlated)[kinds]
        evidence.information += weighted @ design
        evidence.vector += weighted @ measured
    return evidence


def found(evidence: InformationForm, wrong: bool = False) -> list[Diagnosis]:
    return against_file.found(MACHINE, evidence, wrong)


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_from_the_start_is_named_with_how_far(name: str) -> None:
    (one,) = found(driven(4.0, wrong=(name, WRONG[name])))
    assert one.of[0] == name
    assert one.code is (Code.DRAWBAR_OFF if name == DRAWBAR else Code.RECEIVER_OFF)
    off = np.array(one.amounts) - np.array(WRONG[name])
    assert np.all(np.abs(off) < 3.0 * np.array(one.sds))


@pytest.mark.parametrize("seed", range(4))
def test_a_right_file_with_late_receivers_is_not(seed: int) -> None:
    late = np.random.default_rng(seed).normal(0.0, [r.latency.sd for r in MACHINE.receiver])
    for minutes in (0.5, 2.0, 8.0):
        assert found(driven(minutes, seed, tuple(late.tolist()))) == []


@pytest.mark.parametrize("mount", list(Mount))
def test_at_one_speed_straight_ahead_a_length_looks_like_a_latency(mount: Mount) -> None:
    assert found(driven(4.0, turns=False, wrong=(mount.value, (0.25, 0.0)))) == []


def test_what_was_found_stays_found_a_little_below_its_limit() -> None:
    for minutes in np.arange(0.5, 6.0, 0.25):
        evidence = driven(float(minutes), wrong=(DRAWBAR, (0.16,)))
        if found(evidence, wrong=True) and not found(evidence):
            break
    else:
        pytest.fail("no time at which only what was found before is found")
    assert 0.0 < AGAINST_FILE.ends < 1.0
