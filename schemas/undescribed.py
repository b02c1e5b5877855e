"""An implement that nobody has described: what may be hitched on, as wide as implements are."""

import tomllib
from typing import Any, Final

UNDESCRIBED: Final = "undescribed"
"""Its name, which no file may have."""
GENERIC: Final[dict[str, Any]] = {
    "name": UNDESCRIBED,
    "described": False,
    "d": {"value": 4.0, "sd": 1.0},
    "e": {"value": 0.25, "sd": 0.2},
    "mass": {"value": 4000.0, "sd": 2000.0},
    "yaw_inertia": {"value": 10000.0, "sd": 5000.0},
    "cg_height": {"value": 1.3, "sd": 0.3},
    "cg_sd": 0.25,
    "lever_sd": 0.5,
    "pair_yaw_sd": 4.0,
}
"""Single-axle carts, tankers and trailers of 1 to 12 t, 3 to 5.5 m from hitch to axle."""
TYRES: Final = {"cornering_stiffness": 220e3, "relaxation_length": 1.1, "log_sd": 0.9}
"""Six times the load of its axle per rad; the sd is that of tyres and of the mass."""
SURVEY_SD: Final = 0.4  # m, of where its receivers are


def undescribed(implement: str) -> str:
    """The text of its file, with the receivers of another one's: who swaps implements takes them along.
    implement: the text of that file, one that can be read."""
    # Imported here: only who describes a tractor with several implements needs it.
    import tomlkit

    mounted = [
        one | {"survey_sd": SURVEY_SD} for one in tomllib.loads(implement).get("receiver", [])
    ]  # fmt: skip
    return tomlkit.dumps({"implement": GENERIC, "tyres": {"implement": TYRES}, "receiver": mounted})
