"""What the rigs of simulator/fleet.py are drawn from: a range of each number, with its source or its reason.

"Data sheets" are makers' published ones of current machines, of which rounded ranges are taken: compact
tractors as the Deere 5E or the Kubota M, utility ones as the Fendt 300 or the Deere 6R of four cylinders,
row-crop ones as the Deere 6R and 7R or the Case Puma, heavy ones as the Deere 8R or the Case Magnum; grain
carts of 300 to 400 bushels, slurry tankers of 5 to 8 m^3, trailed sprayers of 2 to 4 m^3, trailers to 8 t.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

TRACTORS: Final = ("compact", "utility", "row_crop", "heavy")
IMPLEMENTS: Final = ("grain_cart", "slurry_tanker", "sprayer", "trailer")
ANY: Final = "any"


class DrawnRange(NamedTuple):
    """Drawn uniformly from low to high; a share where both are the chance of something."""

    of: str  # a kind of tractor or implement, or ANY
    name: str
    low: float
    high: float
    unit: str
    source: str


_SHEETS: Final = "data sheets"
_SIZES: Final = ("mass", "wheelbase", "hitch_behind", "front_track", "rear_track", "front_radius",
                 "rear_radius", "cg_height")  # fmt: skip
_SIZE_UNITS: Final = ("kg", "m", "m", "m", "m", "m", "m", "m")
_SIZE_SOURCES: Final = (
    f"{_SHEETS}: ready to work, without ballast",
    _SHEETS,
    f"{_SHEETS}: drawbar and pick-up hitch behind the rear axle",
    f"{_SHEETS}: what the axle can be set to for rows",
    f"{_SHEETS}: what the axle can be set to for rows",
    "tyre tables, static loaded radius",
    "tyre tables, static loaded radius: 380/90R46 0.85 m, 650/65R42 0.86 m, 380/90R54 0.93 m",
    "roll-over tests: a little above the rear axle",
)
_TRACTORS: Final[Mapping[str, tuple[tuple[float, float], ...]]] = {
    "compact": ((3000, 4200), (1.95, 2.30), (0.45, 0.70), (1.30, 1.60), (1.30, 1.65), (0.40, 0.52),
                (0.58, 0.70), (0.70, 0.85)),
    "utility": ((4200, 6500), (2.30, 2.62), (0.60, 0.85), (1.50, 1.85), (1.50, 1.90), (0.50, 0.62),
                (0.72, 0.85), (0.78, 0.95)),
    "row_crop": ((6500, 9500), (2.60, 2.92), (0.75, 1.00), (1.60, 2.10), (1.65, 2.15), (0.60, 0.72),
                 (0.84, 0.95), (0.88, 1.10)),
    "heavy": ((9500, 13000), (2.90, 3.15), (0.85, 1.15), (1.75, 2.25), (1.80, 2.30), (0.68, 0.78),
              (0.90, 1.02), (0.98, 1.22)),
}  # fmt: skip
_CARRIED: Final = ("empty", "full", "hitch_to_axle", "track", "radius", "empty_height", "full_height",
                   "gyration")  # fmt: skip
_CARRIED_UNITS: Final = ("kg", "kg", "m", "m", "m", "m", "m", "1")
_CARRIED_SOURCES: Final = (
    f"{_SHEETS}: empty",
    f"{_SHEETS}: gross mass on one axle",
    f"{_SHEETS}: eye to axle",
    f"{_SHEETS}; of a sprayer what the axle can be set to",
    "tyre tables, static loaded radius",
    "centre of gravity: frame and empty body",
    "centre of gravity: body filled to half its height above the frame",
    "yaw radius of gyration over hitch to axle: a uniform body 1.2 to 1.6 times as long; Table 5.1 0.47",
)
_IMPLEMENTS: Final[Mapping[str, tuple[tuple[float, float], ...]]] = {
    "grain_cart": ((2000, 4200), (8000, 12000), (3.4, 4.8), (2.0, 2.9), (0.70, 0.90), (1.20, 1.50),
                   (1.45, 1.85), (0.28, 0.47)),
    "slurry_tanker": ((2200, 4000), (7000, 12000), (4.0, 5.5), (1.85, 2.25), (0.62, 0.80), (1.05, 1.35),
                      (1.25, 1.60), (0.28, 0.42)),
    "sprayer": ((1800, 3200), (4200, 7500), (3.8, 5.2), (1.50, 2.25), (0.75, 0.95), (1.10, 1.45),
                (1.20, 1.55), (0.30, 0.50)),
    "trailer": ((1000, 2000), (4000, 8000), (3.0, 4.5), (1.50, 1.90), (0.45, 0.60), (0.85, 1.10),
                (1.10, 1.50), (0.28, 0.42)),
}  # fmt: skip

_OTHERS: Final[tuple[tuple[str, float, float, str, str], ...]] = (
    ("front_share", 0.36, 0.44, "1", "weight in front with front-wheel assist, bare: Deere's manuals 35 %, "
     "Wisconsin Extension 40 %"),
    ("ballast_share", 0.04, 0.11, "1", "front weights over the tractor's mass: 300 to 1500 kg"),
    ("ballast_ahead", 0.6, 1.2, "m", "front weights ahead of the front axle"),
    ("tractor_gyration", 0.55, 0.70, "1", "yaw radius over wheelbase: Table 5.1 has 0.67"),
    ("tractor_roll", 0.50, 0.60, "1", "roll radius over rear track, assumed: 1.05 of 1.93 m"),
    ("implement_roll", 0.34, 0.48, "1", "the same of implements, assumed: a body as wide as the track"),
    ("axle_share", 0.06, 0.10, "1", "front axle with wheels over the tractor's mass: 600 to 900 kg of 9 t"),
    ("pin_share", 0.90, 1.20, "1", "pivot of the front axle over its wheels' loaded radius: at the hubs"),
    ("hitch_height", 0.38, 0.75, "m", "ISO 6489-3 drawbars 0.38 to 0.56 m; ball couplings (K80) above"),
    ("twin_spacing", 0.55, 0.76, "m", "between the middles of dual wheels: 22 to 30 inches"),
    ("suspension_hz", 1.2, 1.8, "Hz", "front axles as suspended by hydraulic cylinders"),
    ("suspension_damping", 0.2, 0.5, "1", "the same, over the critical one"),
    ("front_deflection", 0.040, 0.090, "m", "radial tyres: a fifth of their section under full load"),
    ("rear_deflection", 0.045, 0.110, "m", "the same"),
    ("implement_deflection", 0.050, 0.110, "m", "the same, with the implement full"),
    ("vertical_damping", 0.006, 0.030, "s", "damping over stiffness: 0.05 to 0.25 of the roll mode"),
    ("empty_tongue", 0.03, 0.12, "1", "load on the hitch over the implement's weight: data sheets"),
    ("full_tongue", 0.05, 0.15, "1", "the same; up to 3 t are allowed on a ball"),
    ("cornering", 3.0, 9.0, "1/rad", "stiffness of an axle over its load: Karkee 2009, 2.4 to 10.6"),
    ("relaxation", 1.0, 2.5, "1", "relaxation length over loaded radius: Karkee 2009 has 1.1 to 2.3"),
    ("load_exponent", 0.5, 1.0, "1", "tyres are degressive, or, as eq. 5.34 has it, proportional"),
    ("camber_thrust", 0.0, 0.5, "1", "side force over load for each rad of lean: radials little"),
    ("grip", 0.5, 0.9, "1", "largest side force over load: soft to firm soil"),
    ("rolling", 0.03, 0.10, "1", "ASABE D497: 1/Bn + 0.04, firm to soft, less on stubble"),
    ("ackermann", 0.7, 1.0, "1", "linkages of tractors, assumed"),
    ("front_drive", 0.25, 0.40, "1", "share of the drive force where the front wheels are driven"),
    ("play", 0.0, 0.15, "deg", "of wheel sensors' linkages"),
    ("bend", -0.01, 0.01, "1", "how far a wheel sensor's gain bends to 30 degrees"),
    ("latency", 0.05, 0.15, "s", "of receivers: the machine file's default 0.10 with sd 0.05"),
    ("base_jump", 0.01, 0.03, "m", "of all positions, where another base takes over or it is surveyed anew"),
    ("speed", 3.0, 5.0, "m/s", "field work"),
    ("antennas_apart", 1.2, 2.6, "m", "of a pair; as far apart as the body is long at most"),
    ("roof", 1.9, 2.3, "m", "antennas of a tractor above its centre of gravity: on cab and hood"),
    ("mast", 0.9, 1.8, "m", "the same of an implement"),
)  # fmt: skip
CHANCES: Final = (
    DrawnRange(ANY, "ballasted", 0.5, 0.5, "chance", "front weights are put on for heavy implements"),
    DrawnRange(ANY, "driven_in_front", 0.5, 0.5, "chance", "assist engaged"),
    DrawnRange(
        ANY, "roll_corrected", 0.3, 0.3, "chance", "the tractor's receivers report the point on the ground"
    ),
    DrawnRange(ANY, "base_moves", 0.2, 0.2, "chance", "a base that is not one's own"),
    DrawnRange("utility", "suspended", 0.2, 0.2, "chance", "an option"),
    DrawnRange("row_crop", "suspended", 0.5, 0.5, "chance", "usual in Europe"),
    DrawnRange("heavy", "suspended", 0.7, 0.7, "chance", "nearly standard"),
    DrawnRange("row_crop", "duals", 0.15, 0.15, "chance", "for spring work"),
    DrawnRange("heavy", "duals", 0.4, 0.4, "chance", "usual in North America"),
)
RANGES: Final = (
    *(
        DrawnRange(kind, name, *ends, unit, source)
        for kinds, names, units, sources in (
            (_TRACTORS, _SIZES, _SIZE_UNITS, _SIZE_SOURCES),
            (_IMPLEMENTS, _CARRIED, _CARRIED_UNITS, _CARRIED_SOURCES),
        )
        for kind, row in kinds.items()
        for name, ends, unit, source in zip(names, row, units, sources, strict=True)
    ),
    *(DrawnRange(ANY, *row) for row in _OTHERS),
)
