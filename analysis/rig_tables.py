"""A rig report in words and tables, for a terminal 80 columns wide."""

import math
from collections.abc import Callable, Iterator, Sequence

from rich import box
from rich.console import RenderableType
from rich.table import Table

from tilth.analysis.rig_report import AtSpeed, DriveFacts, RigReport, Understeer
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import WITHIN, half_width

TABLE_OMEGA = (0.2, 1.0, 2.0, 5.0, 10.0)  # rad/s, of those in the report
Row = tuple[str, ...]


def rig_tables(name: str, report: RigReport) -> Iterator[RenderableType]:
    """What an engineer asks of a rig before driving it. report: as rig_report.rig_report makes it."""
    yield rig_in_words(name, report) + "\n"
    for title, headings, row in _TABLES:
        yield _table(title, headings, report, row)
    yield _bounds(report)
    for model, speed, at in _cells(report):
        for design in at["lqr"].values():
            if "reason" in design:
                yield f"{model} at {speed} m/s: {design['reason']}"


def _cells(report: RigReport) -> Iterator[tuple[str, str, AtSpeed]]:
    for model, speeds in report["models"].items():
        for speed, at in speeds.items():
            yield model, speed, at


def _table(
    title: str, headings: Row, report: RigReport, row: Callable[[AtSpeed], Row | None]
) -> RenderableType:
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False,
        collapse_padding=True,
    )  # fmt: skip
    table.add_column("model", no_wrap=True)
    for heading in ("m/s", *headings):
        table.add_column(heading, justify="right", no_wrap=True)
    previous = ""
    for model, speed, at in _cells(report):
        cells = row(at)
        if cells is not None:
            table.add_row(model if model != previous else "", speed, *cells)
            previous = model
    return table


def rig_in_words(name: str, report: RigReport) -> str:
    """Masses, lengths, loads, tyres and how it understeers."""
    parameters = {key: row["value"] or 0.0 for key, row in report["parameters"].items()}
    loads = ", ".join(f"{axle} {load / 1000:.1f}" for axle, load in report["static_loads_N"].items())
    stiffness = ", ".join(f"{parameters[key] / 1000:.0f}" for key in PARAMETERS[:3])
    lengths = ", ".join(f"{parameters[key]:.2f}" for key in PARAMETERS[3:])
    return "\n".join(
        [
            f"{name}: tractor {parameters['m_t']:.0f} kg with wheelbase "
            f"{parameters['a'] + parameters['b']:.2f} m, implement {parameters['m_i']:.0f} kg with its axle "
            f"{parameters['d'] + parameters['e']:.2f} m behind the hitch.",
            f"Axle loads {loads} kN. Cornering stiffness front, rear, implement {stiffness} kN/rad; "
            f"relaxation length {lengths} m.",
            _understeer_in_words(report["understeer"]),
        ]
    )


def _understeer_in_words(understeer: Understeer) -> str:
    gradient = f"{understeer['gradient_deg_per_g']:+.2f}°/g"
    limit = understeer["characteristic_speed_m_per_s"]
    if limit is None:
        return f"It is neutral (understeer gradient {gradient}): no speed changes the wheel angle of a turn."
    if limit < 0:
        return (
            f"It OVERSTEERS (understeer gradient {gradient}): above {-limit:.1f} m/s it turns by itself and "
            "no wheel angle holds it."
        )
    extra = ", ".join(
        f"{100 * (ratio - 1):.1f} % at {speed} m/s"
        for speed, ratio in understeer["wheel_angle_ratio"].items()
    )
    return (
        f"It understeers (gradient {gradient}, characteristic speed {limit:.1f} m/s): a turn needs more "
        f"wheel angle than rolling without slip by {extra}."
    )


def _steady(at: AtSpeed) -> Row:
    turn = at["steady_turn_per_rad"]
    if turn is None:
        return ("–",) * 4
    degree = math.radians(1.0)
    return (
        f"{turn['yaw_rate']:.3f}",
        f"{turn['yaw_rate_dB']:.2f}",
        f"{turn['lateral_velocity'] * degree:.4f}",
        f"{turn['articulation']:.3f}",
    )


def _open_loop(at: AtSpeed) -> Row:
    return (
        _pole(at["dominant"]),
        _number(at["settling_time_s"], 1),
        _number(at["settling_distance_m"], 1),
        *_least_damped(at),
        "{rank}/{of}".format(**at["controllability"]),
        "{rank}/{of}".format(**at["observability"]),
    )


def _least_damped(at: AtSpeed) -> Row:
    """Frequency and damping of the pair that swings longest in its own periods."""
    pairs = [
        (ratio, math.hypot(*pole))
        for pole, ratio in zip(at["eigenvalues"], at["damping"], strict=True)
        if pole[1] > 0
    ]
    if not pairs:
        return "–", "–"
    ratio, omega = min(pairs)
    return f"{omega:.2f}", f"{ratio:.2f}"


def _frequency(at: AtSpeed) -> Row:
    response = at["frequency_response"]
    columns = [response["omega_rad_per_s"].index(omega) for omega in TABLE_OMEGA]
    yaw = response["r_t"]
    return tuple(f"{yaw['gain_dB'][k]:.1f} {round(yaw['phase_deg'][k]):4d}°" for k in columns)


def _closed_loop(at: AtSpeed) -> Row:
    cells: list[str] = []
    for design in at["lqr"].values():
        if "reason" in design:
            cells += ["none", "–", "–", "–"]
        else:
            cells += [
                _number(slowest[0] if (slowest := design["dominant"]) else None, 2),
                _number(design["dominant_damping"], 2),
                _number(design["settling_time_s"], 1),
                _number(design["settling_distance_m"], 0),
            ]
    return tuple(cells)


_TABLES: tuple[tuple[str, Row, Callable[[AtSpeed], Row | None]], ...] = (
    (
        "Steady turning, for each degree of wheel angle",
        ("yaw rate\n°/s", "yaw rate\ndB (1/s)", "lateral velocity\nm/s", "articulation\n°"),
        _steady,
    ),
    (
        "Open loop: dominant eigenvalue, 2 % settling, least damped pair; how many states the wheel angle "
        "controls and positions and headings show",
        ("dominant\n1/s", "settles\ns", "within\nm", "pair\nrad/s", "damping\nratio", "con-\ntrolled",
         "ob-\nserved"),
        _open_loop,
    ),
    (
        "Tractor's yaw rate over wheel angle, dB and phase, at so many rad/s",
        tuple(f"{omega:g}" for omega in TABLE_OMEGA),
        _frequency,
    ),
    (
        "LQR (Q = 1, R = 800), on the wheel angle itself and then through the steering actuator: real part "
        "of the dominant pair, its damping ratio, 2 % settling",
        ("pole\n1/s", "ratio", "settles\ns", "within\nm") * 2,
        _closed_loop,
    ),
)  # fmt: skip


def _bounds(report: RigReport) -> RenderableType:
    drive = report["drive"]
    if all(at["bound"] is None for _, _, at in _cells(report)):
        return "The kinematic model has no tyres: no manoeuvre tells anything about them through it."
    title = (
        f"What {drive['seconds']:g} s of {drive['manoeuvre']} at ±{drive['amplitude_deg']:g}° can tell: "
        f"at best (Cramér-Rao), each parameter to so many % of its value (± of 95 %). Measured: "
        + _sensors(drive)
    )
    return _table(title, (*PARAMETERS, "rank"), report, _bound)


def _sensors(drive: DriveFacts) -> str:
    """Such as: y_t ±0.035 m (95 %) at 5 Hz."""
    words = []
    for row in drive["sensor_rows"]:
        unit = _UNIT.get(row["output"], "m" if row["output"].startswith("y") else "°")
        size = row["sd"] if unit == "m" else math.degrees(row["sd"])
        words.append(f"{row['output']} {half_width(size, unit)} at {1 / row['every_s']:.0f} Hz")
    return ", ".join(words)


_UNIT = {"r_t": "°/s", "r_i": "°/s", "v": "m/s", "v_i": "m/s"}


def _bound(at: AtSpeed) -> Row | None:
    found = at["bound"]
    if found is None:
        return None
    return *(_share(found["sd"].get(name, "")) for name in PARAMETERS), "{rank}/{of}".format(**found)


def _share(sd: float | str | None) -> str:
    if isinstance(sd, str):
        return "–"
    if sd is None:
        return "open"
    percent = 100 * WITHIN * sd
    return f"{percent:.1f}" if percent < 100 else f"{percent:.0f}"


def _pole(pole: Sequence[float] | None) -> str:
    if pole is None:
        return "–"
    real, imaginary = pole
    return f"{real:.2f}" if imaginary == 0 else f"{real:.2f}±{abs(imaginary):.2f}j"


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
