"""Receivers whose gyros are later than their positions: the delay is learned, and not taken for tyres.

Of an independent plant whose turn rates were up to 50 ms late, four in five intervals of random steering held
before this was an unknown; C_ar came out as much as a quarter too soft.
"""

from dataclasses import replace

import numpy as np
import pytest
from drives import LEARNING, QUIET, driven, errors, values

from tilth.estimator.methods import pem, tracker
from tilth.simulator.scenario import RollSensor

pytestmark = pytest.mark.long


DELAY = 0.06  # s
LATE = replace(
    QUIET, roll_sensor=RollSensor(turn_rate_delay=DELAY), steering=(*LEARNING, (12.0, 6.0), (12.0, -6.0))
)


@pytest.mark.parametrize("method", [pem.METHOD, tracker.METHOD])
def test_a_delay_is_learned_and_the_six_hold(method: str) -> None:
    late, on_time = driven(LATE, 66.0), driven(replace(LATE, roll_sensor=RollSensor()), 66.0)
    found, usual = late.last(method), on_time.last(method)
    assert np.nanmax(np.abs(errors(late, found))) < 3.0
    # The same drive but for the delay: it moves the tyres by little.
    assert np.nanmax(np.abs(values(found) - values(usual))) < 0.15  # logarithms
    for body in ("t", "i"):
        delay, sd = found.nuisances[f"rate_late_{body}"]
        none, _ = usual.nuisances[f"rate_late_{body}"]
        assert sd < 0.03 and abs(delay - DELAY) < 3.0 * sd
        assert delay - none > 0.6 * DELAY
