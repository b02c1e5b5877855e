"""Writes docs/dissertation.md and its figures: `uv run python -m studies.dissertation.page`.

From a development install; into docs/, or a folder given.
"""

import sys
from pathlib import Path
from string import Template

from studies.dissertation import chapter6, closed_loop, errata, field_page, field_tables, open_loop
from studies.dissertation.compared import ComparedFigure, compared, number
from studies.dissertation.field_errata import field_errata
from studies.dissertation.figures import DRAWINGS
from tilth.analysis import plots
from tilth.analysis.fit import published_values
from tilth.analysis.report.wording import heading_of
from tilth.schemas.flow import PARAMETERS

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMAND = "uv run python -m studies.dissertation.page"

PAGE = Template("""\
# The dissertation's figures, and ours

M. Karkee, *Modeling, identification and analysis of tractor and single axle towed implement system*, 2009,
chapters 3, 5, 6 and 7. Written by `$command`, not by hand. Parameters are those of its Table 5.1
([jd7930-parker500-ch5.toml](../deploy/machines/jd7930-parker500-ch5.toml)) unless said otherwise.

A printed number agrees where ours rounds to it, or, where it is given as "about", within what the last
column says. $count of $total agree; why the others do not stands beside them. `tilth model` gives such
numbers for any rig.

## Steady turning and steps (3.2, 3.6)

$steady

![Yaw rate after a step of 10°](figures/figure-3-6.svg)

*Figure 3.6: tractor's yaw rate after the wheels are turned by 10° at once.*

![Paths after a step of 10°](figures/figure-3-7.svg)

*Figure 3.7: path of the tractor's CG after the same step.*

## Eigenvalues (5.3.1)

$eigenvalues

Dominant eigenvalues that are no integrators, 1/s:

$dominant

![Eigenvalues](figures/figure-5-3.svg)

*Figure 5.3: eigenvalues; the real axis is logarithmic beyond ±1.*

## Frequency response (5.3.1)

$frequency

Yaw rate over wheel angle, gain in dB and phase in degrees:

$responses

How far the three models lie apart, dB and degrees:

$spreads

They agree below 0.2 Hz and part above. Phase parts them first; at 7.5 m/s the kinematic model is also 1 dB
off from the start, because it does not understeer.

![At 1.0 m/s](figures/figure-5-4.svg)

*Figure 5.4: frequency response at 1.0 m/s.*

![At 2.5 m/s](figures/figure-5-5.svg)

*Figure 5.5: frequency response at 2.5 m/s.*

![At 4.5 m/s](figures/figure-5-6.svg)

*Figure 5.6: frequency response at 4.5 m/s. The measured spectra of figures 5.4 to 5.6 are not in the text.*

## The regulator (5.3.2)

LQR with R = 800 and Q = 1 on every state; the steering actuator (K = 10, I = 1, d = 10) is added to the
dynamic models and not to the kinematic one, as there.

$regulator

![Closed-loop eigenvalues](figures/figure-5-7.svg)

*Figure 5.7: closed-loop eigenvalues.*

![Settling distance and damping](figures/figure-5-8.svg)

*Figure 5.8: relaxation model with actuator.*

## On the nonlinear plant (5.4)

The plant is the planar model with all sines and cosines, constant speed of 4.5 m/s, and tyres by 5.34 made
odd, F = −sign(α) N A (1 − exp(−B |α|)). The dissertation gives no A and B: A = $grip is taken, and B such
that the axle has the cornering stiffness of Table 5.1. N is the load at rest; with forces in proportion to
the load, its transfer from one side to the other changes nothing.

$tyres

The controller acts every $period ms and its command is held. The start is 5 m to the right of the line,
both bodies turned by 20° to the right, that is away from the line: only so are the printed angles reached.

$runs

![Tracking errors](figures/figure-5-9.svg)

*Figure 5.9: tracking error with both designs.*

![Heading errors and wheel angle](figures/figure-5-10.svg)

*Figure 5.10: relaxation design, pointing away from the line.*

What details of the plant change, for the relaxation design:

$variants

### What the instability owes to the wiring

The actuator of 5.33 integrates: its input commands a *rate* of steering. The kinematic gain is designed
without it, to give a wheel angle. Fed into the actuator's input it is unstable at every speed from 0.5 to
10 m/s, and already on the kinematic model itself: no tyre takes part in it. Where the same gain sets the
wheel angle, at once or through a servo, or where the actuator is in the model it is designed on, the
kinematic design follows the line on the same plant. The finding that a controller designed on the kinematic
model is unstable at 4.5 m/s holds for that wiring; it is no statement about the kinematic model. (The
dissertation does not say how they are joined. Of these four ways only the first gives the small positive
real part that it reports.) Dominant eigenvalues, 1/s, and runs from 5 m and 20°:

$wirings

The servo asks for $servo rad of command for each rad of missing wheel angle. Dominant real parts over
speed:

$wiring_speeds

## Sensitivity and uncertainty (6)

The relaxation model with the parameters of Table 7.2, after the wheels are turned by 10° at once, simulated
for 30, 6 and 3 s at 1.0, 4.5 and 7.5 m/s: six outputs, their mean (6.17), each parameter raised by 1 %
(6.16).

$sensitivity

![Overall sensitivities](figures/figure-6-8.svg)

*Figure 6.8: overall sensitivity to each of the eight parameters.*

Over the box of table 6.2 the dissertation took 5 values of each of the eight parameters, 390,625 points at
each of the three speeds, 10.5 million simulations. `tilth sensitivity --global` makes them in minutes.

$global_sensitivity

![Sensitivities over the box](figures/figure-6-10.svg)

*Figure 6.10: means over all points, and the medians that they hide.*

$global_values

Points that are unstable: $unstable.

For the Monte Carlo (figures 6.11 and 6.12) the three stiffnesses vary together; half of the central 68 % of
the motion's change is given.

$uncertainty

`tilth uncertainty` does this for any parameters, with any correlations, and for any output
([sensitivity.md](sensitivity.md)).

$fields

## Published elsewhere

What is in print of cornering stiffnesses (kN/rad of the whole axle) and relaxation lengths (m) of tractors
and implements in fields, with the 95 % interval where a source gives a standard deviation. `tilth compare
LOG published` shows a log's fit beside them ([published.toml](../analysis/fit/published.toml)). Metz (1993),
Schwanghart and Rott (1984) and Bevly et al. (2002), after which the dissertation calculated its initial
values, were not at hand, so no number of theirs stands here.

$published

## Printed and right

$errata
""")


def sections() -> dict[str, list[ComparedFigure]]:
    """The lines of each section that compares figures."""
    return {
        "steady": open_loop.steady_lines(),
        "eigenvalues": [*open_loop.eigenvalue_lines(), *open_loop.relaxation_lines()],
        "frequency": [
            *open_loop.gain_lines(), *open_loop.resonance_lines(), *open_loop.agreement_lines(),
        ],
        "regulator": [*closed_loop.regulator_lines(), *closed_loop.settling_lines()],
        "sensitivity": chapter6.local_lines(),
        "global_sensitivity": chapter6.global_lines(),
        "uncertainty": chapter6.uncertainty_lines(),
        "runs": [*closed_loop.unstable_lines(), *closed_loop.run_lines()],
    }  # fmt: skip


def page() -> str:
    """The page in Markdown."""
    compare = sections()
    lines = [line for section in compare.values() for line in section]
    pairs = [(1.0, "tractor"), (4.5, "tractor"), (4.5, "implement"), (7.5, "tractor")]
    return PAGE.substitute(
        {name: compared(section) for name, section in compare.items()},
        command=COMMAND,
        count=str(sum(line.agrees for line in lines)),
        total=str(len(lines)),
        dominant=open_loop.dominant_table(),
        responses="\n\n".join(open_loop.frequency_table(speed, body) for speed, body in pairs),
        spreads=open_loop.spread_table(),
        grip=number(closed_loop.GRIP, 1),
        period=f"{1000 * closed_loop.PERIOD_S:.0f}",
        tyres=closed_loop.tyre_table(),
        variants=closed_loop.variant_table(),
        wirings=closed_loop.wiring_table(),
        wiring_speeds=closed_loop.wiring_speeds(),
        global_values=chapter6.global_table(),
        unstable=chapter6.unstable_sentence(),
        servo=number(closed_loop.SERVO, 1),
        published=published_table(),
        fields=field_page.section(field_tables.read()),
        errata=errata.errata_table([*errata.errata(), *chapter6.errata(), *field_errata()]),
    )


def published_table() -> str:
    """The product's table, and its sources."""
    heads = ["of", *map(heading_of, PARAMETERS), "source"]
    rows = [heads, ["---", *["---:"] * len(PARAMETERS), "---"]]
    sources: list[str] = []
    for one in published_values.own():
        sources += [] if one.source in sources else [one.source]
        about = "; ".join(filter(None, (one.where, one.rig, one.load, one.tyre, one.soil, one.how)))
        told = (one.told(name) or "–" for name in PARAMETERS)
        rows.append([one.title, *told, f"[{sources.index(one.source) + 1}], {about}"])
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n\n" + "\n\n".join(f"[{k}] {text}." for k, text in enumerate(sources, 1))


def main(arguments: list[str]) -> None:
    """Write into docs/, or the folder given."""
    docs = Path(arguments[0]) if arguments else DOCS
    (docs / "figures").mkdir(parents=True, exist_ok=True)
    (docs / "dissertation.md").write_text(page(), encoding="utf-8")
    with plots.look():
        for name, draw in DRAWINGS.items():
            plots.save(draw(), docs / "figures" / f"{name}.svg")


if __name__ == "__main__":
    main(sys.argv[1:])
