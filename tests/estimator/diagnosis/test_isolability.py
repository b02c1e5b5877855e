"""Which faults are told apart by rows and turns; `--refresh` writes the table of docs/check.md."""

import numpy as np
import pytest
from circle import demo_machine
from numpy.typing import NDArray
from paths import ROOT

from tilth.estimator.diagnosis.hypotheses import isolability
from tilth.estimator.diagnosis.information import InformationForm, lengths, rows
from tilth.estimator.diagnosis.sample import BodySample, Sample

Array = NDArray[np.float64]

PAGE = ROOT / "docs/check.md"
BEGIN, END = "<!-- isolability -->\n", "<!-- end -->"
MACHINE = demo_machine()
SHORT = {"tractor_front": "TF", "tractor_rear": "TR", "implement_front": "IF", "implement_rear": "IR"}
WORDS = {"pair_t": "pair T", "pair_i": "pair I", "wheel_zero": "wheel", "d": "drawbar"}


def form(minutes: float, one_speed: bool = False) -> InformationForm:
    """Of a turn of 20 s after each row of 80 s, at half of the speed."""
    rig, found = lengths(MACHINE), InformationForm()
    for pose in range(round(minutes * 300.0)):
        t_s = 0.2 * pose
        turn = t_s % 100.0 > 80.0
        u, r = (1.9, 0.3) if turn else (3.5 + (0.0 if one_speed else 0.5 * np.sin(t_s / 40.0)), 0.0)
        u = 3.5 if one_speed else u
        fold = 0.5 * float(np.sin((t_s % 100.0 - 80.0) / 20.0 * np.pi)) if turn else 0.0
        tractor, implement = (
            BodySample(heading, 0.0, float(u), 0.0, r, 0.02 * float(np.sin(t_s / 7.0)), (0.0, 0.0))
            for heading in (fold, 0.0)
        )
        kinds, design, _ = rows(rig, Sample(tractor, implement, (0.0, 0.0), 0.0))
        found.information += (design.T / (rig.sds[kinds] ** 2 * rig.correlated[kinds])) @ design
    return found


def short(number: str) -> str:
    """Such as: TF forward."""
    for mount, name in SHORT.items():
        if number.endswith(mount):
            what = number.removesuffix(f"_{mount}")
            return f"{name} {'late' if what == 'latency' else what}"
    return WORDS[number]


def table(names: list[str], angles: Array) -> str:
    heads = [short(name) for name in names]
    lines = [f"| | {' | '.join(heads[:-1])} |", "|---" * len(heads) + "|"]
    for k, head in enumerate(heads[1:], 1):
        cells = [f"{angles[k, j]:.0f}" if j < k else "" for j in range(len(heads) - 1)]
        lines.append(f"| {head} | {' | '.join(cells)} |")
    legend = "T is the tractor, I the implement, F front, R rear."
    return "\n".join(["", *lines, "", legend, "", ""])


def test_the_table_of_the_page_is_what_the_residuals_say(request: pytest.FixtureRequest) -> None:
    made = table(*isolability(MACHINE, form(60.0), form(10.0)))
    page = PAGE.read_text(encoding="utf-8")
    head, rest = page.split(BEGIN)
    stands, tail = rest.split(END)
    if request.config.getoption("--refresh"):
        PAGE.write_text(head + BEGIN + made + END + tail, encoding="utf-8")
        stands = made
    assert stands == made, "run this test with --refresh"


def test_at_one_speed_further_forward_looks_like_later() -> None:
    forward, late = "forward_tractor_front", "latency_tractor_front"
    found = []
    for one_speed in (True, False):
        names, angles = isolability(MACHINE, form(20.0, one_speed), form(5.0, one_speed))
        assert np.allclose(np.diag(angles), 0.0, atol=1e-5) and np.allclose(angles, angles.T, atol=1e-5)
        found.append(angles[names.index(forward), names.index(late)])
    assert found[0] < found[1]
