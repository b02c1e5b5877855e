"""A rig with a load on its implement."""

from tilth.estimator.models.parameters import Rig, checked, static_loads
from tilth.schemas.flow import PARAMETERS


def loaded(
    rig: Rig,
    payload: float,
    *,
    ahead: float = 0.0,
    length: float = 4.0,
    width: float = 2.6,
    height: float = 1.8,
) -> Rig:
    """The rig with a load on the implement: mass, inertia, CG and, by its axles' loads, stiffness change.

    payload: kg, spread evenly over a box of `length` and `width` (m) whose centre is `ahead` of the empty
    implement's CG and `height` above the ground (m). Each stiffness grows with its axle's load to the power
    of rig.load_exponent. Raises ValueError, as `checked`.
    """
    mass = rig.m_i + payload
    shift = payload * ahead / mass
    inertia = rig.I_i + rig.m_i * shift**2
    inertia += payload * ((length**2 + width**2) / 12 + (ahead - shift) ** 2)
    full = rig._replace(
        m_i=mass,
        I_i=inertia,
        d=rig.d - shift,
        e=rig.e + shift,
        h_i=(rig.m_i * rig.h_i + payload * height) / mass,
    )
    ratios = [new / old for new, old in zip(static_loads(full), static_loads(rig), strict=True)]
    stiffness = {
        name: getattr(rig, name) * abs(ratio) ** rig.load_exponent
        for name, ratio in zip(PARAMETERS[:3], ratios, strict=True)
    }
    return checked(full._replace(**stiffness))
