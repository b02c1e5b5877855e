"""How the weight of a rig at rest stands on its three axles."""


def axle_loads(
    a: float, b: float, c: float, d: float, e: float, m_t: float, m_i: float, g: float
) -> tuple[float, float, float]:
    """Vertical loads of the three axles on level ground, N: front, rear, implement. May be compiled.

    Symbols as in docs/notation.md. The implement's tongue rests on the hitch with what its axle, e behind its
    CG, does not carry.
    """
    weight_i = m_i * g
    tongue = weight_i * e / (d + e)
    front = (b * m_t * g - (c - b) * tongue) / (a + b)
    return front, m_t * g + tongue - front, weight_i - tongue
