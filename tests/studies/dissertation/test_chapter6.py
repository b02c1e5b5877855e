"""Chapter 6 beside ours: what agrees stays so, what differs has a reason, what is kept is right."""

import numpy as np
import pytest

from studies.dissertation import chapter6
from studies.dissertation.compared import compared
from tilth.analysis.sensitivity.designs import DISSERTATION, Grid
from tilth.analysis.sensitivity.run_batches import GlobalPlan, part_of
from tilth.estimator.models.parameters import TABLE_7_2


def test_every_difference_has_a_reason() -> None:
    lines = [*chapter6.local_lines(), *chapter6.global_lines(), *chapter6.uncertainty_lines()]
    assert len(compared(lines).splitlines()) == len(lines) + 2
    assert 10 <= sum(line.agrees for line in lines) < len(lines)


def test_the_kept_means_are_those_of_a_sample() -> None:
    """Of 1,500 points of the grid at 7.5 m/s, spread over all of it."""
    (entry,) = (one for speed, one in chapter6._everywhere().items() if speed == 7.5)
    plan = GlobalPlan("relaxation", TABLE_7_2, 7.5, 3.0, Grid(DISSERTATION))
    starts = np.linspace(0, plan.design.size - 50, 30).astype(int)
    parts = [part_of(plan, int(start), int(start) + 50) for start in starts]
    unstable = sum(int(part.unstable[0, 0].sum()) for part in parts) / 1500
    assert unstable == pytest.approx(entry["unstable_share"], abs=0.05)
    total = np.sum([part.stable.total for part in parts], axis=0) / sum(part.stable.counted for part in parts)
    kept = [row["mean"] for row in entry["global_stable"].values()]
    overall = total.reshape(len(kept), -1)[:, 0]  # of each parameter the mean over the outputs comes first
    np.testing.assert_allclose(overall, kept, rtol=0.25)


@pytest.mark.parametrize("speed", [1.0, 4.5, 7.5])
def test_what_must_be_known_gives_what_is_wanted(speed: float) -> None:
    assert chapter6.out_of(speed, chapter6.known_to(speed, 4.0) / 100) == pytest.approx(4.0, abs=0.1)
    assert 0 < chapter6.out_of(speed, 0.05) < chapter6.out_of(speed, 0.2)
