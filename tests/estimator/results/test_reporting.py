"""What is said of an estimate."""

from logs import MACHINE

from tilth.estimator.filters.unknowns import AT
from tilth.estimator.methods import tracker
from tilth.estimator.results import reporting


def test_what_is_said_of_other_unknowns_has_room_for_errors_of_the_model() -> None:
    state = tracker.initial(MACHINE)
    state.covariance[6:, 6:] *= 1e-6  # hours of rows
    said = tracker.estimate(state, MACHINE, 1).nuisances
    for name, room in reporting.NUISANCE_MODEL_SD.items():
        least = min(room, state.prior_sd[AT[name]])
        assert 0.999 * least <= said[name][1] <= 1.1 * least, name
