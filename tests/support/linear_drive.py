"""A drive of the filters' linear model with its own disturbances: for it they are the right model."""

import math

import numpy as np
from circle import demo_machine
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.measurement_model import observation, predict_measurement
from tilth.estimator.filters.propagation import (
    empty_plant,
    ground_at,
    linearise,
    set_bank,
    set_plant,
    set_processes,
    stationary,
)
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.sensors.wheel_angle import set_wheel_noise
from tilth.estimator.filters.states import ACROSS, ALONG, DT, N_STATES, X_DISTURBANCE, X_POSITION, X_PSI, X_V
from tilth.estimator.filters.transition import Transition, empty_transition
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.models.manoeuvres import manoeuvre_named
from tilth.estimator.record.record import Record
from tilth.estimator.results import advice
from tilth.estimator.results.advice import Candidate
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SPEED = 4.5
LINEAR = unknowns.prior(demo_machine())[0]
LINEAR[AT["curvature"]] = 0.0


def one_tick(setup: RigSetup, point: Array) -> Transition:
    """The linear model at SPEED: the same at each tick but for the position, which is not in it."""
    plant = empty_plant(setup, 0)
    set_plant.interpreted()(plant, point, setup, likelihood.NOTHING)
    ticks, step = np.zeros((10, 8)), empty_transition(0, 0, 1)
    ticks[:, 1] = SPEED
    set_bank.interpreted()(SPEED, setup, step)
    set_processes.interpreted()(SPEED, ground_at.interpreted()(point), setup, step, 0)
    set_wheel_noise.interpreted()(SPEED, point, setup.sds, step)
    linearise.interpreted()(np.zeros(N_STATES), ticks, 0, point, plant, step)
    return step


def moving(seed: int, setup: RigSetup, point: Array, wheel: Array) -> Array:
    """(n, 26): states of the linear model with its own disturbances."""
    rng, step = np.random.default_rng(seed), one_tick(setup, point)
    noise = rng.normal(size=(len(wheel), N_STATES)) * np.sqrt(step.q[0])
    along, across = rng.normal(size=(2, len(wheel))) * [[ALONG], [ACROSS]] * math.sqrt(DT)
    x = np.zeros((len(wheel), N_STATES))
    ground = ground_at.interpreted()(point)
    x[0] = rng.normal(size=N_STATES) * np.sqrt(stationary.interpreted()(ground, setup))
    for k in range(len(wheel) - 1):
        x[k + 1] = step.F @ x[k] + noise[k]
        x[k + 1, :X_DISTURBANCE] += step.wheel * (wheel[k] + wheel[k + 1]) / 2
        v, psi = (x[k, X_V] + x[k + 1, X_V]) / 2, (x[k, X_PSI] + x[k + 1, X_PSI]) / 2
        forward, right = DT * SPEED + along[k], DT * v + across[k]
        x[k + 1, X_POSITION] = x[k, X_POSITION] + forward * math.cos(psi) - right * math.sin(psi)
        x[k + 1, X_POSITION + 1] = x[k, X_POSITION + 1] + forward * math.sin(psi) + right * math.cos(psi)
    return x


def simulated(seed: int, machine: Machine, candidate: Candidate) -> Record:
    """A drive of the linear model at LINEAR with its own disturbances and white sensors."""
    count = round((advice.ADVICE.seconds + 1.0) / DT) + 1
    time: Array = np.arange(count, dtype=np.float64) * DT
    setup, point = rig_setup(machine, linear=True), LINEAR
    ticks = np.zeros((count, 8))
    ticks[:, 0] = manoeuvre_named(candidate.manoeuvre).wheel_angle(
        time, math.radians(candidate.degrees), np.random.default_rng(1)
    )
    ticks[:, 1] = SPEED
    x, rng = moving(seed, setup, point, ticks[:, 0]), np.random.default_rng(5000 + seed)
    ticks[:, 2:4] = x[:, X_PSI : X_PSI + 2]
    rows = advice.planned_rows(machine, count, (advice.ADVICE.receiver_rate,) * 4)
    unused = np.zeros(N_STATES + len(point))
    observe, predict = observation.interpreted(), predict_measurement.interpreted()
    for row in rows:
        k = int(row[0])
        obs = observe(ticks, row, k, SPEED, x[k], x[min(k + 1, count - 1)], point)
        at = x[k] + obs.share * (x[min(k + 1, count - 1)] - x[k])
        value = predict(at, obs, point, setup, unused)
        row[4] = value + rng.normal(0, row[5])
    return Record(0, ticks, rows)
