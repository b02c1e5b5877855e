"""A step over all windows of a drive: it goes to the truth where the model is the filter's own."""

import numpy as np
from circle import demo_machine
from linear_drive import LINEAR, simulated

from studies.turns.study import TurnWindow, step
from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.unknowns import NOISE, SIX
from tilth.estimator.methods import pem
from tilth.estimator.results.advice import Candidate

MACHINE = demo_machine()


def test_two_windows_tell_more_than_one_and_keep_the_truth() -> None:
    setup, (_, sd) = rig_setup(MACHINE, linear=True), unknowns.prior(MACHINE)
    windows = []
    for seed in range(2):
        record = simulated(seed, MACHINE, Candidate("chirp", 5.0))
        known = pem.with_known_masses(np.diag(sd**2))
        search = likelihood.search_of(record, setup, LINEAR, known)
        search.start = np.zeros(N_STATES)
        windows.append(TurnWindow(search, LINEAR[NOISE]))
    state = pem.initial(MACHINE)
    sds = []
    for some in (windows[:1], windows):
        there, wide = step(MACHINE, state, some, LINEAR, steered=True, past=True)
        assert np.all(np.abs((there - LINEAR)[SIX]) < 3.5 * wide)
        sds.append(wide)
    assert np.all(sds[1] < sds[0]) and np.all(sds[1] > 0.5 * sds[0])
