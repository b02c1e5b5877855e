"""Where a disc meets the ground: the nearest point in its plane, on planes, on bumps and on short waves."""

import math

import numpy as np
import pytest

from tilth.simulator.scenario import Bump, Ground
from tilth.simulator.spatial.contact import contact_of
from tilth.simulator.spatial.height_field import HeightField, height, height_field

pytestmark = pytest.mark.long


contact, up_at = contact_of.interpreted(), height.interpreted()
RADIUS = 0.9
STEEP = Bump(north=5.0, east=0.0, height=0.2, length=2.0, width=2.0, ramp=0.1)


def made(ground: Ground, rms: float = 0.0) -> HeightField:
    return height_field(ground, rms, np.random.default_rng(4))


def turned(camber: float, heading: float) -> np.ndarray:
    """Axes of a body that leans right and heads, rad, as MuJoCo has them."""
    s, c = math.sin(heading), math.cos(heading)
    lean = np.array(
        [[1, 0, 0], [0, math.cos(camber), -math.sin(camber)], [0, math.sin(camber), math.cos(camber)]]
    )
    return np.asarray(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ lean).ravel()


def nearest(field: HeightField, hub: tuple[float, float, float]) -> float:
    """Distance from a hub to the ground in the plane of a disc that stands upright and heads north, m."""
    ahead = np.linspace(-1.2, 1.2, 4001)
    down = [-up_at(field, hub[0] + float(a), hub[1])[0] - hub[2] for a in ahead]
    return float(np.hypot(ahead, down).min())


@pytest.mark.parametrize(("camber", "heading"), [(0.0, 0.0), (0.1, 0.7), (-0.08, 3.0)])
def test_on_a_slope_it_is_the_foot_of_a_perpendicular(camber: float, heading: float) -> None:
    """A level bump near by changes nothing."""
    slope = Ground(slope_deg=8.0, downhill_deg=30.0)
    hub, turn = (1.0, 2.0, -0.9), turned(camber, heading)
    plain = contact(made(slope), turn, hub, 0.1, RADIUS)
    level = Bump(north=1.5, east=2.5, height=0.0)
    searched = contact(made(Ground(slope_deg=8.0, downhill_deg=30.0, bumps=(level,))), turn, hub, 0.1, RADIUS)
    for one, other in zip(plain, searched, strict=True):
        assert other == pytest.approx(one, abs=2e-4)
    assert searched[4] == pytest.approx(plain[4], abs=1e-7)
    assert np.dot(plain[3], plain[1]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("ground", [Ground(bumps=(STEEP,)), Ground(waves=(0.3, 1.0))], ids=["bump", "waves"])
def test_nothing_of_the_ground_is_nearer(ground: Ground) -> None:
    field, upright = made(ground, 0.0 if ground.bumps else 0.03), turned(0.0, 0.0)
    assert field.sharp != bool(ground.bumps)
    for north in np.arange(3.0, 7.0, 0.17):
        hub = (float(north), 0.1, -0.95)
        point, ahead, right, down, far, _, _ = contact(field, upright, hub, 0.0, RADIUS)
        assert far == pytest.approx(nearest(field, hub), abs=1e-4)
        assert -point[2] == pytest.approx(up_at(field, point[0], point[1])[0], abs=2e-3)
        np.testing.assert_allclose(
            np.array([ahead, right, down]) @ np.transpose([ahead, right, down]), np.eye(3), atol=1e-12
        )


def test_a_tyre_is_pressed_in_by_no_more_than_the_bump_is_high() -> None:
    """The plane that touches the ramp would press it in by half a metre."""
    field, upright = made(Ground(bumps=(STEEP,))), turned(0.0, 0.0)
    pressed = [
        RADIUS - contact(field, upright, (float(north), 0.0, -RADIUS), 0.0, RADIUS)[4]
        for north in np.arange(2.5, 7.5, 0.02)
    ]
    assert max(pressed) == pytest.approx(STEEP.height, abs=1e-6) and min(pressed) > -1e-6


def test_the_push_is_the_slope_of_the_springs_energy() -> None:
    """So it gives back what it takes. The hub moves a little ahead, or down, and the distance changes."""
    field, upright, d = made(Ground(bumps=(STEEP,))), turned(0.0, 0.0), 1e-4
    for north in (3.5, 3.7, 4.02, 4.06, 5.6, 5.98, 6.3):
        down = contact(field, upright, (north, 0.0, -0.95), 0.0, RADIUS)[3]
        for k, step in ((0, (d, 0.0)), (2, (0.0, d))):
            before, after = (
                contact(field, upright, (north + s * step[0], 0.0, -0.95 + s * step[1]), 0.0, RADIUS)[4]
                for s in (-1, 1)
            )
            assert (after - before) / (2 * d) == pytest.approx(-down[k], abs=2e-3)
