"""Chapter 6 of the dissertation: sensitivities and the uncertainty of outputs, beside ours.

Local values and the Monte Carlo are computed here; the 10.5 million simulations of figure 6.10 are kept in
chapter6_global.json, as `tilth sensitivity --global` makes them.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.special import ndtri

from studies.dissertation.compared import ComparedFigure, claim, figures, number, table
from studies.dissertation.errata import Erratum
from tilth.analysis.sensitivity.local import LocalSensitivities, local_sensitivities, overall
from tilth.analysis.sensitivity.outputs import NAMES, SIX, case_of, measured, respond
from tilth.analysis.sensitivity.slopes import VARIED, scaled
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2

Array = NDArray[np.float64]

SECONDS: Final = {1.0: 30.0, 4.5: 6.0, 7.5: 3.0}  # simulated at each speed, m/s
STIFFNESSES: Final = VARIED[:3]
LENGTHS: Final = VARIED[3:6]
ABOUT: Final = 0.025  # of a height read from a bar
_COLUMNS: Final = [NAMES.index(name) for name in SIX]
_RELAXATION: Final = model_named("relaxation")
_FACTORS: Final = np.geomspace(0.12, 6.0, 81)


@cache
def _local(speed: float) -> LocalSensitivities:
    return local_sensitivities(_RELAXATION, TABLE_7_2, speed, seconds=SECONDS[speed], parameters=VARIED)


@cache
def _overall(speed: float) -> dict[str, float]:
    return dict(zip(VARIED, overall(_local(speed).step).tolist(), strict=True))


def _largest(name: str) -> tuple[float, str, float]:
    """(value, output, speed) of the largest local sensitivity to a parameter, of the six outputs."""
    found = [
        (float(_local(speed).step[VARIED.index(name), column]), NAMES[column], speed)
        for speed in SECONDS
        for column in _COLUMNS
    ]
    return max(found)


@cache
def _everywhere() -> dict[float, dict[str, Any]]:
    """Figure 6.10, by speed."""
    kept = json.loads(Path(__file__).with_name("chapter6_global.json").read_text(encoding="utf-8"))
    return {entry["speed"]: entry for entry in kept["speeds"]}


@cache
def _variation(speed: float) -> Array:
    """Change of the motion where all stiffnesses are multiplied by each of _FACTORS: the mean size over the
    six outputs, with the sign of the heading's change."""
    case = case_of(_RELAXATION, TABLE_7_2, speed, SECONDS[speed])
    reference = respond(case, TABLE_7_2)
    found = []
    for factor in _FACTORS.tolist():
        rig = scaled(TABLE_7_2, dict.fromkeys(STIFFNESSES, factor))
        change = respond(case, rig).minus(reference)
        sign = math.copysign(1.0, float(change.headings[-1, 0]) * float(reference.headings[-1, 0]))
        found.append(sign * float(measured(case, reference, change)[_COLUMNS].mean()))
    return np.array(found)


def out_of(speed: float, share: float) -> float:
    """Half of the central 68 % of the motion's change, per cent, where the three stiffnesses together have
    this standard deviation, a share: by log-normal draws, which are never negative."""
    log_sd = math.sqrt(math.log1p(share**2))
    factors = np.exp(log_sd * ndtri((np.arange(2000) + 0.5) / 2000))
    low, high = np.quantile(np.interp(factors, _FACTORS, _variation(speed)), [0.16, 0.84])
    return float(100 * (high - low) / 2)


def known_to(speed: float, out: float) -> float:
    """Standard deviation of the stiffnesses, per cent, that makes so much per cent of change."""
    shares = np.linspace(0.01, 1.0, 100)
    made = np.array([out_of(speed, share) for share in shares.tolist()])
    return float(100 * np.interp(out, np.maximum.accumulate(made), shares))


def local_lines() -> list[ComparedFigure]:
    """Section 6.3.1, figures 6.3 to 6.8."""
    one, mid, fast = (_overall(speed) for speed in SECONDS)
    why = {
        7.5: "0.26 is what 6.0 to 6.5 m/s give; neither Table 5.1's relaxation lengths nor another horizon "
        "does"
    }
    lines = [
        figures("figure 6.8", f"overall sensitivity to C_af, C_ar at {speed:g} m/s", printed,
                [_overall(speed)[name] for name in ("C_af", "C_ar")], digits=2, within=ABOUT,
                why=why.get(speed, ""))
        for speed, printed in ((1.0, [0.2, 0.2]), (4.5, [0.15, 0.15]), (7.5, [0.26, 0.26]))
    ]  # fmt: skip
    ratio = [
        max(values[name] for name in LENGTHS) / max(values["C_af"], values["C_ar"])
        for values in (one, mid, fast)
    ]
    lines.append(
        claim("figure 6.8", "the largest relaxation length's over the largest stiffness's", "about 1, ½, ½",
              ", ".join(number(value, 2) for value in ratio),
              ratio[0] > 0.8 and all(0.25 < value < 0.75 for value in ratio[1:]))
    )  # fmt: skip
    lines += [
        figures("figure 6.8", f"overall to m_i, I_i at {speed:g} m/s", printed,
                [_overall(speed)[name] for name in ("m_i", "I_i")], digits=2, within=0.015)
        for speed, printed in ((1.0, [0.05, 0.05]), (4.5, [0.02, 0.02]))
    ]  # fmt: skip
    inertia = max(_largest("m_i"), _largest("I_i"))
    lines.append(
        figures("figure 6.3", f"largest to m_i or I_i (ours: {inertia[1]} at {inertia[2]:g} m/s)", [0.14],
                [inertia[0]], digits=2, within=ABOUT)
    )  # fmt: skip
    largest = [_largest(name) for name in STIFFNESSES]
    where = ", ".join(f"{output} at {speed:g}" for _, output, speed in largest)
    lines.append(
        figures("figure 6.4", f"largest to C_af, C_ar, C_ai (ours: {where} m/s)", [0.4, 0.7, 0.2],
                [value for value, *_ in largest], digits=1, within=0.05,
                why="v changes sign between 5 and 8 m/s: its root mean square is a poor denominator")
    )  # fmt: skip
    still = [
        max(_local(speed).step[VARIED.index(name), NAMES.index("position")] for name in LENGTHS)
        for speed in SECONDS
    ]
    lines.append(
        claim("figure 6.5", "relaxation lengths on positions, 1.0, 4.5, 7.5 m/s", "negligible",
              ", ".join(number(value, 4) for value in still), max(still) < 0.05, "less so when fast")
    )  # fmt: skip
    return lines


def global_lines() -> list[ComparedFigure]:
    """Section 6.3.2, figure 6.10: means over all points of the grid of table 6.2."""
    printed = {
        1.0: (("C_af", "C_ar", "sigma_r", "I_i"), [0.15, 0.24, 0.23, 0.05]),
        4.5: (("C_af", "C_ar", "sigma_r", "I_i"), [0.27, 0.35, 0.13, 0.05]),
        7.5: (("C_af", "sigma_r", "I_i"), [0.43, 0.14, 0.07]),
    }
    lines = []
    for speed, (names, values) in printed.items():
        entry = _everywhere()[speed]
        ours = [entry["global"][name]["mean"] for name in names]
        stable, medians = (
            ", ".join(number(entry[which][name][key], 2) for name in names)
            for which, key in (("global_stable", "mean"), ("global", "median"))
        )
        why = (
            f"{100 * entry['unstable_share']:.2g} % of the points are unstable, and a few per cent near "
            f"instability make the mean; of stable points alone {stable}, medians {medians}. No rule for "
            "what was left out is printed"
        )
        lines.append(
            figures("figure 6.10", f"mean over the box at {speed:g} m/s: {', '.join(names)}", values, ours,
                    digits=2, why=why)
        )  # fmt: skip
    ranks = {
        speed: sorted(entry["global"], key=lambda name: -entry["global"][name]["mean"])
        for speed, entry in _everywhere().items()
    }
    lines.append(
        claim("figure 6.10", "the most influential, by means",
              "1.0: C_ar, σ_r, C_af; 4.5: C_ar, C_af; 7.5: C_af, C_ar",
              "; ".join(f"{speed:g}: {', '.join(rank[:3])}" for speed, rank in ranks.items()),
              ranks[1.0][:3] == ["C_ar", "sigma_r", "C_af"] and ranks[4.5][:2] == ["C_ar", "C_af"]
              and ranks[7.5][:2] == ["C_af", "C_ar"],
              "by medians C_af comes first at 1.0 and 4.5 m/s")
    )  # fmt: skip
    least = {speed: rank[-1] for speed, rank in ranks.items()}
    lines.append(
        claim("6.3.2, 6.4", "the least influential", "σ_i; in the conclusions the inertia",
              "; ".join(f"{speed:g}: {name}" for speed, name in least.items()), False,
              "the two places contradict each other; it depends on the speed")
    )  # fmt: skip
    return lines


def uncertainty_lines() -> list[ComparedFigure]:
    """Section 6.3.3, figures 6.11 and 6.12."""
    why = (
        'of the readings of "output variation" that were tried, the mean size with the sign of the '
        "heading's change fits the other speeds; at 1.0 m/s all hangs on how long the ringing is averaged"
    )
    lines = [
        figures("figure 6.11", f"% of change by 10 % of the stiffnesses at {speed:g} m/s", [printed],
                [out_of(speed, 0.10)], digits=1, within=0.3,
                why=why if speed == 1.0 else "")
        for speed, printed in ((1.0, 1.5), (4.5, 2.0), (7.5, 4.0))
    ]  # fmt: skip
    lines += [
        figures("figure 6.12", f"% of change by 50 % at {speed:g} m/s", [printed], [out_of(speed, 0.50)],
                digits=0, within=2.0,
                why="of normal draws with 50 % some are not positive, and how these were treated is not "
                "said; ours are log-normal")
        for speed, printed in ((4.5, 20.0), (7.5, 35.0))
    ]  # fmt: skip
    lines.append(
        figures("figure 6.12", "for 5 % of change, stiffnesses known to, %: 1.0, 4.5, 7.5 m/s", [50, 25, 15],
                [known_to(speed, 5.0) for speed in SECONDS], digits=0, within=3.0,
                why="as above; at 4.5 m/s it agrees")
    )  # fmt: skip
    return lines


def global_table() -> str:
    """Means, medians and the middle 90 % of all points, by speed."""
    rows = []
    for speed, entry in _everywhere().items():
        for name, row in sorted(entry["global"].items(), key=lambda pair: -pair[1]["mean"]):
            stable = entry["global_stable"][name]
            rows.append((
                f"{speed:g} m/s, {name}", number(row["mean"], 3), number(row["median"], 3),
                f"{number(row['q05'], 3)} … {number(row['q95'], 3)}", number(stable["mean"], 3),
            ))  # fmt: skip
    return table(("", "mean", "median", "middle 90 %", "mean of stable points"), rows)


def unstable_sentence() -> str:
    """How many points are unstable, and where."""
    found = []
    for speed, entry in _everywhere().items():
        where = entry["unstable_where"].removeprefix("unstable: ")
        found.append(f"at {speed:g} m/s {100 * entry['unstable_share']:.2g} % ({where})")
    return "; ".join(found)


def errata() -> list[Erratum]:
    """Rows of chapter 6."""
    means = _everywhere()[7.5]["global_stable"]
    least = {speed: min(entry["global"], key=lambda name: entry["global"][name]["mean"])
             for speed, entry in _everywhere().items()}  # fmt: skip
    return [
        Erratum("6.3.2, twice", "tractor front tire relaxation length", "front cornering stiffness C_αf",
                f"at 7.5 m/s 0.43 is named: of stable points C_αf has {number(means['C_af']['mean'], 2)}, "
                f"σ_f {number(means['sigma_f']['mean'], 2)}"),
        Erratum("figure 6.10, caption", "360,000 points", "390,625", "five levels of eight parameters"),
        Erratum("figure 6.11 d, caption", "4.5 m/s", "7.5 m/s", "4.5 m/s is the panel before"),
        Erratum("6.3.2 and 6.4", "least influential: σ_i; the inertia", "–",
                "; ".join(f"{speed:g} m/s: {name}" for speed, name in least.items())),
    ]  # fmt: skip


def overall_bars() -> Figure:
    """Figure 6.8."""
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    axes = figure.subplots(1, 3, squeeze=False, sharey=True)[0]
    for panel, speed in zip(axes, SECONDS, strict=True):
        values = _overall(speed)
        panel.bar(range(len(values)), list(values.values()), color="#0072b2")
        panel.set(title=f"{speed:g} m/s", xticks=range(len(values)))
        panel.set_xticklabels(list(values), rotation=60)
    axes[0].set_ylabel("% of the motion for 1 %")
    return figure


def global_bars() -> Figure:
    """Figure 6.10: the mean, and the median beside it."""
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    axes = figure.subplots(1, 3, squeeze=False, sharey=True)[0]
    for panel, (speed, entry) in zip(axes, _everywhere().items(), strict=True):
        place = np.arange(len(VARIED))
        for shift, key, colour in ((-0.2, "mean", "#d55e00"), (0.2, "median", "#0072b2")):
            heights = [entry["global"][name][key] for name in VARIED]
            panel.bar(place + shift, heights, 0.4, color=colour, label=key)
        panel.set(title=f"{speed:g} m/s", xticks=place)
        panel.set_xticklabels(VARIED, rotation=60)
    axes[0].set_ylabel("% of the motion for 1 %")
    axes[0].legend()
    return figure
