"""Segments whose soils differ: a variance between them, intervals that hold, groups, and never a number
beyond all of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from told_segments import LEARNED, MACHINE, MEAN, SD, Floats, around, drawn, masses, root_of, told

from tilth.analysis.fit.agreement import agree, between_sd, groups, with_room
from tilth.analysis.fit.joint import Joint, join
from tilth.analysis.fit.window_terms import SegmentTerms
from tilth.schemas.spread import WITHIN


def segments_of(
    rng: np.random.Generator, truths: Sequence[Floats], rows: int = 60, scale: float = 20.0
) -> list[SegmentTerms]:
    return [told(truth, root_of(rng, rows, scale), rng) for truth in truths]


def soils(rng: np.random.Generator, count: int, sd: float) -> tuple[Floats, list[Floats]]:
    """(the mean, the truth of each segment): the six differ by such an sd of logarithms."""
    mean = drawn(rng)
    each = [mean.copy() for _ in range(count)]
    for one in each:
        one[:6] += sd * rng.normal(size=6)
    return mean, each


def sds(joint: Joint) -> Floats:
    """Of the six, without what the masses add."""
    return np.asarray(np.sqrt(np.diag(joint.covariance)[:6] - np.diag(masses())[:6]))


def errors(joint: Joint, truth: Floats) -> Floats:
    return np.asarray(joint.mean[:6] - MEAN[:6] - truth[:6])


@pytest.mark.parametrize("count", [2, 4])
def test_equal_soils_have_the_ideal_interval(count: int) -> None:
    rng = np.random.default_rng(count)
    holds, widths = [], []
    for _ in range(60):
        truth, each = soils(rng, count, 0.0)
        segments = segments_of(rng, each)
        joint = join(MACHINE, around(segments))
        told_of = np.diag(SD[LEARNED] ** -2.0) + sum(one.information for (one,) in segments)
        widths.append(sds(joint) / np.sqrt(np.diag(np.linalg.inv(told_of))[:6]))
        holds.append(np.abs(errors(joint, truth)) < WITHIN * sds(joint))
    assert np.mean(holds) >= 0.92 and np.median(widths) < 1.01 and np.mean(widths) < 1.1


@pytest.mark.long
@pytest.mark.parametrize(("count", "sd"), [(4, 0.1), (8, 0.1), (8, 0.3)])
def test_intervals_hold_where_soils_differ(count: int, sd: float) -> None:
    """That of the mean, and that of a further segment."""
    rng = np.random.default_rng(count)
    holds, further, found = [], [], []
    for _ in range(40):
        truth, each = soils(rng, count, sd)
        joint = join(MACHINE, around(segments_of(rng, each)))
        holds.append(np.abs(errors(joint, truth)) < WITHIN * sds(joint))
        another = truth[:6] + sd * rng.normal(size=6)
        further.append(np.abs(errors(joint, another)) < WITHIN * joint.new_segment_sd)
        found.append(joint.between_sd)
    assert np.mean(holds) >= 0.9 and np.mean(further) >= 0.9
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(sd, rel=0.25)


@pytest.mark.parametrize("seed", range(12))
def test_no_number_is_beyond_all_segments_that_do_not_agree(seed: int) -> None:
    """Whatever their count, soils and order; what the machine has in common is not moved to explain soils."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    _, each = soils(rng, count, float(rng.uniform(0.1, 0.5)))
    segments = segments_of(rng, each, int(rng.integers(50, 90)))
    all_of = around(segments)
    joint = join(MACHINE, all_of)
    alone = np.array([join(MACHINE, all_of, [k]).mean[:6] for k in range(count)])
    assert not joint.agreement.agrees
    given = ~joint.refused
    assert np.all((joint.mean[:6] >= alone.min(axis=0))[given])
    assert np.all((joint.mean[:6] <= alone.max(axis=0))[given])
    order = rng.permutation(count)
    again = join(MACHINE, around([segments[k] for k in order]))
    assert again.mean == pytest.approx(joint.mean, abs=0.02) and np.array_equal(again.refused, joint.refused)


def test_few_that_differ_a_little_give_a_mean_and_many_that_differ_much_none() -> None:
    rng = np.random.default_rng(2)
    little, much = (join(MACHINE, around(segments_of(rng, soils(rng, 9, sd)[1]))) for sd in (0.06, 0.4))
    assert not little.agreement.agrees and not little.refused.all()
    assert not much.agreement.agrees and much.refused.all()


def test_what_the_machine_has_in_common_does_not_take_up_what_soils_differ_by() -> None:
    """Two soils, a factor of two apart: forced to one, the unknowns in common were many sds off."""
    rng = np.random.default_rng(3)
    truth = drawn(rng)
    other = truth.copy()
    other[:6] -= 0.7
    joint = join(MACHINE, around(segments_of(rng, [truth] * 3 + [other] * 3)))
    off = (joint.mean - MEAN)[LEARNED[6:]] - truth[6:]
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(joint.covariance)[LEARNED[6:]]))


def test_a_shared_error_of_proportion_does_not_pull_the_mean_below() -> None:
    """Peelle's pertinent puzzle: of 1.0 and 1.5, each to 10 % and both to 20 %, the mean is between."""
    root = np.zeros((6, len(LEARNED)))
    root[:, :6] = np.eye(6) * 10.0
    change = np.zeros(len(LEARNED))
    segments: list[SegmentTerms] = []
    for value in (0.0, np.log(1.5)):
        change[:6] = value
        (one,) = told(change, root, np.random.default_rng(1), np.full(6, 0.2))
        segments.append((one,))
    joint = join(MACHINE, around(segments))
    alone = [join(MACHINE, around([one])).mean[:6] for one in segments]
    assert np.all(joint.mean[:6] > np.min(alone, axis=0)) and np.all(joint.mean[:6] < np.max(alone, axis=0))
    assert np.all(sds(joint) >= 0.2)


def test_groups_are_the_soils() -> None:
    rng = np.random.default_rng(4)
    dry = drawn(rng)
    wet = dry.copy()
    wet[:6] -= 0.5
    segments = segments_of(rng, [dry, dry, wet, wet, wet, dry])
    assert groups(MACHINE, segments, [10.0] * 5) == ((0, 1, 5), (2, 3, 4))
    assert groups(MACHINE, segments[:2], [10.0]) == ((0, 1),)
    assert groups(MACHINE, [segments[1], segments[2]], [10.0]) == ((0,), (1,))


def test_one_alone_gives_its_own_fit() -> None:
    rng = np.random.default_rng(5)
    fits = tuple((MEAN + k, np.diag(SD**2) / (k + 2.0)) for k in range(2))
    all_of = around(segments_of(rng, [drawn(rng)] * 2))
    joint = join(MACHINE, replace(all_of, alone=fits), [1])
    assert np.array_equal(joint.mean[:6], fits[1][0][:6])
    assert np.array_equal(joint.covariance[:6, :6], fits[1][1][:6, :6]) and not joint.refused.any()


def test_room_for_a_change_is_what_integrating_over_it_leaves() -> None:
    rng = np.random.default_rng(6)
    (one,) = told(drawn(rng), root_of(rng, 80, 10.0), rng)
    spread = np.array([0.1, 0.2, 0.0, 0.3, 0.1, 0.05])
    (found,) = with_room((one,), spread)
    covariance = np.linalg.inv(one.information)
    mean = -covariance @ one.gradient
    covariance[:6, :6] += np.diag(spread**2)
    assert found.information == pytest.approx(np.linalg.inv(covariance), rel=1e-5, abs=1e-5)
    assert found.gradient == pytest.approx(-np.linalg.inv(covariance) @ mean, rel=1e-5, abs=1e-5)
    assert found.scores == pytest.approx(found.information, rel=1e-5, abs=1e-5)


def test_no_variance_where_segments_agree() -> None:
    rng = np.random.default_rng(7)
    segments = segments_of(rng, [drawn(rng)] * 4)
    agreement = agree(MACHINE, segments, [0.0] * 3)
    assert agreement.agrees and not between_sd(MACHINE, segments, agreement).any()
