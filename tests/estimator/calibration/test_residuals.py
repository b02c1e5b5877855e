"""What an estimate leaves over, kind by kind, is told from what the file says of the noise."""

import math

import numpy as np
import pytest

from tilth.estimator.calibration.residuals import (
    KINDS,
    RESIDUALS,
    MeasuredKind,
    residuals,
    sentences,
    squares_of,
)
from tilth.estimator.filters.unknowns import AT, NAMES


def left(
    kind: MeasuredKind, level: float, rms: float, count: int = 4 * RESIDUALS.fewest
) -> tuple[float, bool, str]:
    """level: noise that the fit found, over the file's. rms: of innovations over that."""
    rng, point = np.random.default_rng(2), np.zeros(len(NAMES))
    point[AT[kind.level]] = math.log(level)
    rows = np.repeat(np.array(kind.kinds, np.float64), count)
    z = rng.normal(0.0, rms, len(rows))
    (one,) = residuals(squares_of(rows, z), point)
    assert one.count == len(rows)
    return one.ratio, one.more, sentences([one])[0]


@pytest.mark.parametrize("kind", KINDS, ids=[kind.name for kind in KINDS])
@pytest.mark.parametrize(
    ("level", "rms", "more"), [(1.0, 1.0, False), (0.2, 0.8, False), (3.0, 1.0, True), (1.0, 2.5, True)]
)
def test_noise_that_the_fit_took_up_counts_too(
    kind: MeasuredKind, level: float, rms: float, more: bool
) -> None:
    ratio, is_more, said = left(kind, level, rms)
    assert ratio == pytest.approx(level * rms, rel=0.15) and is_more == more
    assert said.startswith(f"What is left of {kind.words}: ")
    assert ("as expected" in said, kind.why in said) == (not more, more)


def test_of_few_measurements_nothing_is_said() -> None:
    assert (
        residuals({kind.kinds[0]: (1e4, RESIDUALS.fewest - 1) for kind in KINDS}, np.zeros(len(NAMES))) == ()
    )
