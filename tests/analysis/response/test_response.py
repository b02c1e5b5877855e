"""The measured response holds the truth as often as it says, and says when it cannot know."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from steered_drives import SPEED, TRUE, Steering, guided, open_loop, true_response

from tilth.analysis.response.response import OUTPUTS, DriveSamples, MeasuredResponse, measured_response
from tilth.analysis.response.segments import plan_segments, segment_spectra
from tilth.analysis.response.spectra import transfer
from tilth.estimator.models.parameters import TABLE_7_2

pytestmark = pytest.mark.long


BOTH = {"initial": TABLE_7_2, "estimated": TRUE}
SEEDS = 100


def held(found: MeasuredResponse, model: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether circle, gain and phase hold the truth at each excited frequency and output."""
    true = true_response(model, found.omega)
    gain = np.abs(true)
    return (
        (np.abs(found.value - true) <= found.band.radius)[found.excited],
        ((found.band.gain_low <= gain) & (gain <= found.band.gain_high))[found.excited],
        (np.abs(np.angle(found.value / true)) <= found.band.phase_half)[found.excited],
    )


@pytest.mark.parametrize(
    ("model", "steering", "known", "seeds"),
    [
        ("relaxation", "random", BOTH, SEEDS),
        ("relaxation", "steps", BOTH, SEEDS),
        ("relaxation", "random", {"initial": TABLE_7_2}, 20),
        ("dynamic", "random", {"initial": TABLE_7_2}, 20),
    ],
    ids=["random", "steps", "no set is right", "another model"],
)
def test_the_bands_hold_the_truth(model: str, steering: Steering, known: dict[str, Any], seeds: int) -> None:
    shares: list[list[np.ndarray]] = [[], [], []]
    for seed in range(seeds):
        found = measured_response(open_loop(seed, model=model, steering=steering, dt=0.1), known)
        assert found.reason == "" and found.excited.sum() > 10
        for share, one in zip(shares, held(found, model), strict=True):
            share.append(one.ravel())
    for what, share in zip(("circle", "gain", "phase"), shares, strict=True):
        assert 0.93 <= np.concatenate(share).mean() <= 0.97, what


def test_a_band_that_is_a_fifth_too_narrow_would_be_seen() -> None:
    inside = []
    for seed in range(20):
        found = measured_response(open_loop(seed, dt=0.1), BOTH)
        away = np.abs(found.value - true_response("relaxation", found.omega))
        inside.append((away <= 0.8 * found.band.radius)[found.excited].ravel())
    assert np.concatenate(inside).mean() < 0.9


def test_the_right_parameters_are_not_rejected_and_wrong_ones_are() -> None:
    rejected = {"initial": 0, "estimated": 0}
    for seed in range(30):
        found = measured_response(open_loop(seed, dt=0.05, seconds=120.0), BOTH)
        assert found.reference == "estimated"
        for curve in found.curves:
            rejected[curve.name] += bool((curve.overall < 0.01).any())
    assert rejected["initial"] == 30
    assert rejected["estimated"] <= 4  # 30 × 3 outputs × 0.01, which are correlated


def test_leakage_is_gone() -> None:
    """Six seconds of a rig that remembers five: a plain estimate, from the same segments, is far off."""
    corrected: list[np.ndarray] = []
    plain: list[np.ndarray] = []
    for seed in range(20):
        drive = open_loop(seed, seconds=60.0)
        found = measured_response(drive, BOTH)
        plan = plan_segments(
            np.arange(1200) >= 1200 - round(found.segment_s / 0.05 * (found.segments + 1) / 2), 0.05
        )
        assert plan is not None and found.segment_s == 6.0 and len(plan.starts) == found.segments
        u, y = (
            segment_spectra(one, plan)[:, : len(found.hz)]
            for one in (drive.wheel_angle[:, None], np.column_stack(list(drive.outputs.values())))
        )
        true = true_response("relaxation", found.omega)
        for share, value in ((corrected, found.value), (plain, transfer(u[:, :, 0], y, plan).value)):
            share.append((np.abs(value - true) <= found.band.radius)[found.excited].ravel())
    assert np.concatenate(corrected).mean() > 0.92 and np.concatenate(plain).mean() < 0.75


def test_curves_units_and_sentences() -> None:
    drive = open_loop(1, seconds=120.0)
    found = measured_response(drive, BOTH)
    estimated = next(curve for curve in found.curves if curve.name == "estimated")
    assert np.allclose(estimated.response, true_response("relaxation", found.omega))
    assert np.allclose(found.omega, 2 * np.pi * found.hz) and found.speed == pytest.approx(SPEED)
    assert found.outputs == OUTPUTS and 0.9 * found.segments < found.independent < found.segments
    assert (found.coherence[:5] > 0.7).all() and "does not contradict" in estimated.sentence
    assert "follow the wheel angle" in found.curves[0].sentence
    some = measured_response(replace(drive, outputs={"r_i": drive.outputs["r_i"]}), BOTH)
    assert np.allclose(some.value[:, 0], found.value[:, 1])


def test_offsets_of_sensors_change_nothing() -> None:
    drive = open_loop(2, seconds=120.0)
    shifted = replace(
        drive,
        wheel_angle=drive.wheel_angle + 0.02,
        outputs={name: values - 0.05 for name, values in drive.outputs.items()},
    )
    assert np.allclose(
        measured_response(shifted, BOTH).value, measured_response(drive, BOTH).value, rtol=1e-6, atol=1e-8
    )


def test_gaps_are_left_out() -> None:
    drive = open_loop(3, seconds=240.0)
    outputs = {name: values.copy() for name, values in drive.outputs.items()}
    outputs["r_t"][2000:2200] = np.nan
    outputs["r_i"][2190:2210] = 1e3  # nonsense within reach of the gap only if gaps were filled
    outputs["articulation"][2190:2210] = np.nan
    angles = drive.wheel_angle.copy()
    angles[4000] = np.nan
    found = measured_response(replace(drive, wheel_angle=angles, outputs=outputs), BOTH)
    assert found.reason == "" and held(found, "relaxation")[0].mean() > 0.85


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wheel_angle": np.zeros(1200)}, "hardly turned"),
        ({"wheel_angle": np.full(1200, np.nan)}, "no sample"),
        ({"speed": -2.0}, "forward"),
        ({"speed": 0.0}, "forward"),
        ({"dt": 0.01}, "too short"),
    ],
)
def test_what_cannot_be_measured_is_empty_with_a_reason(change: dict[str, Any], words: str) -> None:
    drive = open_loop(4, seconds=60.0)
    found = measured_response(replace(drive, **change), BOTH)
    assert words in found.reason and len(found.hz) == len(found.value) == 0 and found.curves == ()


def test_an_unstable_set_is_drawn_but_not_compared() -> None:
    loose = TABLE_7_2._replace(C_af=600e3, C_ar=30e3)
    drive = open_loop(4, seconds=120.0)
    found = measured_response(drive, {"loose": loose, "estimated": TRUE})
    assert found.reference == "estimated" and np.isnan(found.curves[0].overall).all()
    assert "unstable" in found.curves[0].sentence and np.isfinite(found.curves[0].response).all()
    assert "stable" in measured_response(drive, {"loose": loose}).reason


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wheel_angle": np.full(1200, np.inf)}, "infinite"),
        ({"speed": np.inf}, "infinite"),
        ({"speed": np.full(3, 4.5)}, "speed"),
        ({"wheel_angle": np.zeros(7)}, "as many samples"),
        ({"dt": 0.0}, "apart"),
        ({"outputs": {}}, "outputs"),
        ({"outputs": {"roll": np.zeros(1200)}}, "roll"),
    ],
)
def test_what_is_no_drive_is_refused(change: dict[str, Any], words: str) -> None:
    drive = open_loop(4, seconds=60.0)
    with pytest.raises(ValueError, match=words):
        measured_response(replace(drive, **change), BOTH)


def test_an_unknown_reference_is_refused() -> None:
    drive: DriveSamples = open_loop(4, seconds=60.0)
    with pytest.raises(ValueError, match="none of the sets"):
        measured_response(drive, BOTH, reference="other")
    with pytest.raises(ValueError, match="there are none"):
        measured_response(drive, {})


def test_a_changing_speed_and_a_short_drive_are_noted() -> None:
    drive = open_loop(6, seconds=60.0)
    speed = SPEED * (1.0 + 0.3 * np.sin(np.arange(1200) / 100))
    found = measured_response(replace(drive, speed=speed), {"initial": TABLE_7_2})
    assert "varied" in found.notes[0] and "short" in found.notes[1]


def test_a_guided_drive_is_biased_and_says_so() -> None:
    found = measured_response(guided(1), BOTH, reference="estimated")
    assert found.loop.closed and held(found, "relaxation")[0].mean() < 0.5
    assert measured_response(open_loop(1), BOTH, automatic=True).loop.closed
