"""The relaxation-length model against published numbers and against a derivation of its own."""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import MACHINE_FILE, shared

from tilth.estimator.models.relaxation import (
    GEOMETRY,
    INPUTS,
    STATES,
    Array,
    geometry_of,
    input_matrix,
    system_matrix,
)
from tilth.schemas.machine_toml import parse_machine

RIG = np.array([1.7, 1.2, 2.1, 3.62, 0.1, 9391.0, 2127.0, 35709.0, 6402.0])
THETA = np.array([220e3, 486e3, 167e3, 1.1, 1.5, 1.1])


def _published() -> dict[str, Any]:
    values: dict[str, Any] = json.loads(shared("reference/model_values.json").read_text())
    return values


def _rig(table: str) -> tuple[Array, Array]:
    """(geometry, theta)."""
    values = _published()["parameters"][table]
    return (
        np.array([values[key] for key in ("a", "b", "c", "d", "e", "mt", "mi", "It", "Ii")]),
        np.array([values[key] for key in ("Cf", "Cr", "Ci", "sf", "sr", "si")]),
    )


def _sorted(eigenvalues: Iterable[complex]) -> Array:
    """Shape (n, 2): real and imaginary parts."""
    pairs = sorted(((z.real, z.imag) for z in eigenvalues), key=lambda pair: (round(pair[0], 5), pair[1]))
    return np.array(pairs)


def _steady(u: float, geometry: Array, theta: Array, inputs: Array) -> Array:
    """v, r, articulation of steady running: r_t = r_i, and headings only through their difference."""
    matrix, forced = system_matrix(u, geometry, theta), input_matrix(u, geometry, theta) @ inputs
    # Unknown: v, r, three slip angles, articulation = psi_t - psi_i.
    columns = np.column_stack(
        [
            matrix[:6, 0],
            matrix[:6, 1] + matrix[:6, 2],
            matrix[:6, 3],
            matrix[:6, 4],
            matrix[:6, 5],
            matrix[:6, 7],
        ]
    )
    solution: Array = np.asarray(np.linalg.solve(columns, -forced[:6]), dtype=np.float64)
    return solution[[0, 1, 5]]


@pytest.mark.parametrize("speed", ["0.5", "1.0", "2.5", "4.5", "7.5"])
@pytest.mark.parametrize("table", ["table_5_1", "table_7_2"])
def test_eigenvalues(table: str, speed: str) -> None:
    printed = _published()["eigenvalues"][table]["relaxation"][speed]
    computed = np.linalg.eigvals(system_matrix(float(speed), *_rig(table))).tolist()
    expected = [complex(*pair) for pair in printed]
    np.testing.assert_allclose(_sorted(computed), _sorted(expected), atol=1e-6)


@pytest.mark.parametrize("speed", ["1.0", "2.5", "4.5", "7.5"])
def test_steady_state_gains(speed: str) -> None:
    reference = _published()
    geometry, theta = _rig("table_5_1")
    gains = _steady(float(speed), geometry, theta, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(gains, reference["steady_state_per_rad"][speed], atol=1e-6)


@pytest.mark.parametrize("body", ["tractor", "implement"])
@pytest.mark.parametrize("omega", ["0.1", "1.0", "5.0", "8.0"])
def test_frequency_response(omega: str, body: str) -> None:
    response = _published()["yaw_rate_frequency_response_dB_deg"]["relaxation"]["4.5"]
    geometry, theta = _rig("table_5_1")
    matrix = 1j * float(omega) * np.eye(9) - system_matrix(4.5, geometry, theta)
    transfer = np.linalg.solve(matrix, input_matrix(4.5, geometry, theta)[:, 0])
    gain = transfer[STATES.index("r_t" if body == "tractor" else "r_i")]
    assert 20 * np.log10(abs(gain)) == pytest.approx(response[omega][body][0], abs=1e-5)
    assert np.degrees(np.angle(gain)) == pytest.approx(response[omega][body][1], abs=1e-3)


def _accelerations(u: float, g: Array, theta: Array, state: Array, inputs: Array) -> Array:
    """v', r_t', r_i' by Newton and Euler for each body, with the force in the hitch as an unknown.

    Small angles: every lateral direction is the same. Unknown: lateral accelerations of both CGs, both yaw
    accelerations, and the hitch's lateral force on the implement.
    """
    a, b, c, d, e, m_t, m_i, i_t, i_i = g
    _, r_t, _, alpha_f, alpha_r, alpha_i = state[:6]
    f_f, f_r, f_i = -theta[0] * alpha_f, -theta[1] * alpha_r, -theta[2] * alpha_i
    # unknown: a_t, a_i, r_t', r_i', hitch
    mass_matrix = np.array(
        [
            [m_t, 0, 0, 0, 1.0],
            [0, m_i, 0, 0, -1.0],
            [0, 0, i_t, 0, -c],  # the reaction -hitch at -c
            [0, 0, 0, i_i, -d],  # hitch at +d
            [1.0, -1.0, -c, -d, 0],  # the hitch moves with both bodies: a_t - c r_t' = a_i + d r_i'
        ]
    )
    right = np.array(
        [
            f_f + f_r + m_t * inputs[1],
            f_i + m_i * inputs[2],
            a * f_f - b * f_r,
            -e * f_i,
            0.0,
        ]
    )
    a_t, _, dr_t, dr_i, _ = np.linalg.solve(mass_matrix, right)
    return np.array([a_t - u * r_t, dr_t, dr_i])


finite = st.floats(-1.0, 1.0)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    u=st.floats(0.3, 12.0),
    state=st.lists(finite, min_size=9, max_size=9),
    inputs=st.lists(finite, min_size=3, max_size=3),
    factors=st.lists(st.floats(0.6, 1.6), min_size=15, max_size=15),
)
def test_against_both_bodies_with_the_force_in_the_hitch(
    u: float, state: list[float], inputs: list[float], factors: list[float]
) -> None:
    geometry, theta = RIG * factors[:9], THETA * factors[9:]
    x, w = np.array(state), np.array(inputs)
    rate = system_matrix(u, geometry, theta) @ x + input_matrix(u, geometry, theta) @ w
    np.testing.assert_allclose(rate[:3], _accelerations(u, geometry, theta, x, w), rtol=1e-9, atol=1e-9)
    a, b, c, d, e = geometry[:5]
    directions = [(x[0] + a * x[1]) / u - w[0], (x[0] - b * x[1]) / u]
    directions.append((x[0] - c * x[1] - (d + e) * x[2]) / u + x[7] - x[8])
    expected = [u / theta[3 + i] * (directions[i] - x[3 + i]) for i in range(3)]
    np.testing.assert_allclose(rate[3:6], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(rate[6:], [x[0] + u * x[7], x[1], x[2]], rtol=1e-12)


def test_on_a_side_slope_the_tyres_carry_the_weight() -> None:
    """Straight on with the wheels that this needs: moments about the hitch and about the CG, by hand."""
    slope = 0.5  # m/s^2, right side down
    gravity = np.array([0.0, slope, slope])
    yaw_rate_per_angle = _steady(4.5, RIG, THETA, np.array([1.0, 0.0, 0.0]))[1]
    delta = -_steady(4.5, RIG, THETA, gravity)[1] / yaw_rate_per_angle
    v, r, articulation = _steady(4.5, RIG, THETA, gravity + np.array([delta, 0.0, 0.0]))
    assert r == pytest.approx(0.0, abs=1e-12)
    assert v > 0.0  # it slips downhill, so it faces uphill
    a, b, c, d, e, m_t, m_i = RIG[:7]
    on_implement = THETA[2] * (v / 4.5 + articulation)  # force uphill
    assert on_implement == pytest.approx(m_i * slope * d / (d + e))
    hitch = m_i * slope - on_implement  # what the tractor carries of the implement
    front, rear = THETA[0] * (v / 4.5 - delta), THETA[1] * v / 4.5
    assert front + rear == pytest.approx(m_t * slope + hitch)
    assert a * front == pytest.approx(b * rear - c * hitch)


def test_geometry_of_the_packaged_machine() -> None:
    geometry = geometry_of(parse_machine(MACHINE_FILE.read_text()))
    np.testing.assert_array_equal(geometry, RIG)
    assert len(GEOMETRY) == len(geometry) == len(STATES)
    assert len(INPUTS) == 3
