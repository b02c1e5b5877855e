"""How a driver followed: a late one has, one who looks away or does something else has not."""

import numpy as np
import pytest

from tilth.client.experiment.following import LATEST_S, disturbed, followed, off_the_bar, wanted_at
from tilth.estimator.models.planned_run import DT
from tilth.schemas.sentences import notice_sentence

TIME = np.arange(0.0, 20.0, DT)
BAR = 0.14 * np.sin(2 * np.pi * 0.3 * TIME)
SEEN = np.arange(0.0, 20.0, 0.2)


@pytest.mark.parametrize("late", [0.0, 0.3, 0.5, 0.8, 1.0])
def test_a_late_driver_has_followed(late: float) -> None:
    wheels = np.array([wanted_at(BAR, t - late) for t in SEEN])
    made = followed(BAR, SEEN, wheels)
    assert made.late_s == pytest.approx(late, abs=0.06)
    assert made.share == pytest.approx(1.0, abs=0.02) and made.left < 0.05
    assert disturbed(made) is None
    assert max(off_the_bar(BAR, t, wheel) for t, wheel in zip(SEEN, wheels, strict=True)) < 1e-3 + 0.3 * late


def test_who_does_nothing_or_something_else_has_not() -> None:
    why = disturbed(followed(BAR, SEEN, np.zeros(len(SEEN))))
    assert why is not None and "only 0%" in notice_sentence(why)
    other = 0.14 * np.sin(2 * np.pi * 0.21 * SEEN)
    assert disturbed(followed(BAR, SEEN, other))
    half = np.array([wanted_at(BAR, t) for t in SEEN]) * 0.7
    assert disturbed(followed(BAR, SEEN, half)) is None


def test_the_bar_is_straight_before_the_run_and_after_it() -> None:
    last_s = (len(BAR) - 1) * DT
    assert wanted_at(BAR + 1.0, -3.0) == 0.0
    assert wanted_at(BAR, last_s - 1e-6) == pytest.approx(BAR[-1], abs=1e-5)
    assert wanted_at(BAR, last_s + 0.01) == wanted_at(BAR, 100.0) == 0.0
    assert wanted_at(BAR, 5.01) == pytest.approx((BAR[250] + BAR[251]) / 2)


def test_off_the_bar_counts_from_all_that_was_wanted_lately() -> None:
    step = np.where(TIME < 5.0, 0.0, 0.1)
    assert off_the_bar(step, 5.0 + LATEST_S / 2, 0.05) == 0.0
    assert off_the_bar(step, 5.0 + 2 * LATEST_S, 0.02) == pytest.approx(0.08)
    assert off_the_bar(step, 5.0 + 2 * LATEST_S, 0.15) == pytest.approx(0.05)
