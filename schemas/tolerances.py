"""How far a published number may differ between two kinds of processor; on one kind the bytes are equal.

Libraries of mathematics and of linear algebra round otherwise in the last digits, and filters and fits carry
that on. Whatever is not named here, all that is no floating-point number, and whether a number is there at
all, is equal everywhere.
"""

from typing import Final

PURE: Final = 1e-12  # decoded: sums, products, one function of the library
MADE: Final = 1e-9  # of poses, which a filter smooths
LEARNED: Final = 1e-5  # of estimates
OF_SD: Final = 1e-4  # of a value with its sd beside it, in sds: within this share a fit's search ends

TOLERANCES: Final[dict[str, dict[str, float]]] = {
    "Measurement": dict.fromkeys(
        ("sd", "latitude_deg", "longitude_deg", "altitude_m", "course", "speed", "heading", "yaw_rate",
         "roll", "pitch", "hdop", "angle", "curvature", "whole_mass", "carried_mass"), PURE,
    ),
    "LocationFix": dict.fromkeys(("latitude", "longitude", "altitude", "position_covariance"), PURE),
    "Pose": {
        "origin_latitude_deg": PURE, "origin_longitude_deg": PURE, "articulation": MADE,
        "sd_articulation": MADE, "wheel_angle": MADE, "sd_wheel_angle": MADE, "sd_time": MADE,
    },
    "BodyPose": dict.fromkeys(
        ("x", "y", "sd_position", "heading", "sd_heading", "forward_velocity", "lateral_velocity",
         "sd_velocity", "sd_lateral_velocity", "yaw_rate", "sd_yaw_rate", "roll", "sd_roll"), MADE,
    ),
    "Vector3": dict.fromkeys("xyz", MADE),
    "Quaternion": dict.fromkeys("xyzw", MADE),
    "Color": dict.fromkeys("rgba", MADE),
    "CylinderPrimitive": {"bottom_scale": MADE, "top_scale": MADE},
    "SoilTireEstimate": dict.fromkeys(("log_covariance", "condition", "window_s", "bound"), LEARNED),
    "Parameter": {"value": OF_SD, "sd": OF_SD, "age_s": LEARNED, "per_mass": LEARNED,
                  "per_mass_sd": LEARNED},
    "Nuisance": {"value": OF_SD, "sd": OF_SD},
    "Excitation": {"value": LEARNED},
    "Reason": {"numbers": LEARNED},
    "Advice": dict.fromkeys(("log_sds", "speed", "seconds", "degrees", "after", "turn_after"), LEARNED),
    "SoilPlace": dict.fromkeys(
        ("latitude_deg", "longitude_deg", "radius_m", "this_pass", "neighbours", "prior", "log_mean"),
        LEARNED,
    ),
    "Combination": {"exponents": LEARNED, "log_sd": LEARNED},
    "OwnSteering": {"share": LEARNED, "rms": LEARNED, "seconds": LEARNED},
    "Event": {"latitude_deg": MADE, "longitude_deg": MADE},
    "Value": {"number": LEARNED},
}  # fmt: skip
"""Message -> field -> tolerance: in the field's own unit, of numbers above one a share of the number; where
the message has an sd beside the value, both in sds."""


def apart(one: float, other: float, sd: float | None = None) -> float:
    """By how much two values of a field differ, as TOLERANCES counts it. sd: of the message that it is in."""
    return abs(one - other) / (sd or max(1.0, abs(one), abs(other)))
