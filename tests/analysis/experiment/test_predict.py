"""What runs are predicted to tell: more of them tell more, sides are alike, a log counts as it was fitted."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from logs import MACHINE
from numpy.random import default_rng

from tilth.analysis.experiment import predict
from tilth.analysis.experiment.predict import Known, from_log, from_machine, sds, told_by, told_of, worst_of
from tilth.analysis.fit.fitting import Fitted
from tilth.analysis.fit.joint import Linearised, linearise
from tilth.analysis.fit.segment_fit import FittedWindow, SegmentFit
from tilth.analysis.fit.window_terms import SegmentTerms, places
from tilth.estimator.filters import fit_covariance, unknowns
from tilth.estimator.filters.unknowns import NOISE, SIX
from tilth.estimator.models.planned_run import DT, Scheduled
from tilth.estimator.record.record import NORTH, TICK, YAW_RATE
from tilth.estimator.results.advice import expected
from tilth.schemas.experiment import DrivingLimits, StepsRun

RUN = StepsRun(kind="steps", speed=4.5, amplitude_deg=8, seconds=12, hold_s=2.0)
KNOWN = from_machine(MACHINE)


@cache
def told(replicate: int = 1) -> SegmentTerms:
    return told_by(KNOWN, Scheduled(1, replicate, RUN), DrivingLimits(), 1)


def test_more_runs_tell_more_but_no_model_is_better_than_it_is() -> None:
    prior = unknowns.prior(MACHINE)[1][SIX]
    before, worst = prior, np.inf
    for count in (1, 2, 4):
        after = sds(KNOWN, [told(1)] * count)
        assert np.all(after < before) and worst_of(KNOWN, after) < worst
        assert np.all(after > fit_covariance.FIT_COVARIANCE.model_sd)
        before, worst = after, worst_of(KNOWN, after)


def test_to_either_side_tells_alike() -> None:
    assert sds(KNOWN, [told(1)]) == pytest.approx(sds(KNOWN, [told(2)]), rel=0.05)
    both = [told(k)[0].information for k in (1, 2)]
    assert np.diag(both[0])[SIX] == pytest.approx(np.diag(both[1])[SIX], rel=0.1)


def test_what_is_not_known_of_the_masses_is_no_reason_to_drive_otherwise() -> None:
    sd = sds(KNOWN, [told(1)] * 4)
    assert worst_of(KNOWN, sd) < sd.max() or sd.argmax() != 2
    share = MACHINE.implement.mass.sd / MACHINE.implement.mass.value
    assert sd[2] ** 2 > share**2


def test_what_a_log_told_counts_before() -> None:
    before = Linearised(KNOWN.point, (told(1), told(2)), (100.0,), (12.0, 12.0))
    known = replace(KNOWN, before=before, cache={})
    assert sds(known, ()) == pytest.approx(sds(KNOWN, [told(1), told(2)]), rel=0.02)
    assert np.all(sds(known, [told(1)]) < sds(known, ()))


def test_a_log_tells_its_ground_and_how_often_its_receivers_measure() -> None:
    angles = np.radians(6) * np.sign(np.sin(np.arange(600) * DT * 2))
    mean, sd = unknowns.prior(MACHINE)
    record = expected(MACHINE, mean, 4.5, angles, predict._rows(KNOWN, len(angles)))
    noise = mean[NOISE] + 0.5
    fit = SegmentFit({}, mean, np.diag(sd**2), (FittedWindow(record, noise),), 0.0, {}, 0.0)
    known = from_log(MACHINE, Fitted((), (fit,), (0,), linearise(MACHINE, [fit], []), None))
    assert known.point[NOISE] == pytest.approx(noise)
    assert len(known.rates) == len({(kind, place) for kind, place, _, _ in known.rates})
    yaw = {kind: hertz for kind, _, hertz, _ in known.rates}  # a body's two receivers both measure it
    assert yaw[YAW_RATE] == pytest.approx(10.0) and yaw[NORTH] == pytest.approx(5.0)
    more = told_by(known, Scheduled(1, 1, RUN), DrivingLimits(), 1)
    assert np.all(sds(known, [more]) < sds(known, ()))
    with pytest.raises(ValueError, match="tells nothing"):
        from_log(MACHINE, Fitted((), (), (), None, None))


def test_nothing_known_and_nothing_driven_is_the_prior() -> None:
    assert sds(KNOWN, ()) == pytest.approx(unknowns.prior(MACHINE)[1][SIX])
    with pytest.raises(ValueError, match="nothing to join"):
        predict.joined(KNOWN, ())


def test_receivers_that_a_log_shows_to_be_faster_tell_more() -> None:
    rows = predict._rows(KNOWN, 101)
    kinds = {(kind, place) for kind, place in rows[:, [2, 3]].tolist()}
    rates = tuple(
        (kind, place, 10.0, float(np.median(rows[(rows[:, 2] == kind) & (rows[:, 3] == place), 5])))
        for kind, place in sorted(kinds)
    )
    fast = Known(MACHINE, KNOWN.point, None, rates)
    found = predict._rows(fast, 101)
    assert len(found) == pytest.approx(2 * len(rows), rel=0.1)
    assert np.all(np.diff(found[:, TICK]) >= 0) and found[:, TICK].max() < 100
    angles = np.radians(6) * np.sign(np.sin(np.arange(500) * DT * 2))
    slow_sd, fast_sd = (sds(known, [told_of(known, 4.5, angles)]) for known in (KNOWN, fast))
    assert np.all(fast_sd < slow_sd)


def test_a_long_drive_is_cut_as_the_estimator_cuts_it() -> None:
    angles = 0.05 * default_rng(1).standard_normal(2200)
    rows = predict._rows(KNOWN, len(angles))
    record = expected(MACHINE, KNOWN.point, 4.0, angles, rows)
    first, second = predict._windows(record)
    assert (len(first.ticks), len(second.ticks)) == (1500, 700)
    assert len(first.rows) + len(second.rows) == len(record.rows)
    assert second.rows[:, TICK].min() == 0 and second.rows[:, TICK].max() < 700


def test_terms_are_over_what_segments_share() -> None:
    assert told(1)[0].information.shape == (len(places(MACHINE)),) * 2
