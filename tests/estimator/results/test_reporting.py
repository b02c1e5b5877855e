"""What is said of an estimate."""

from logs import MACHINE

from tilth.estimator.filters.unknowns import AT, UNKNOWNS
from tilth.estimator.methods import tracker


def test_what_is_said_of_other_unknowns_has_room_for_errors_of_the_model() -> None:
    state = tracker.initial(MACHINE)
    state.covariance[6:, 6:] *= 1e-6  # hours of rows
    said = tracker.estimate(state, MACHINE, 1).nuisances
    for name, room in ((row.name, row.model_sd) for row in UNKNOWNS if row.model_sd):
        least = min(room, state.prior_sd[AT[name]])
        assert 0.999 * least <= said[name][1] <= 1.1 * least, name
