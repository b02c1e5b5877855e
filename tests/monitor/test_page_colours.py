"""The page's colours for eyes of every kind: what means something else looks like something else."""

import re
from importlib import resources
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]

CSS = resources.files("tilth.monitor").joinpath("page/page.css").read_text(encoding="utf-8")
THEMES = {
    name: dict(re.findall(r"--([\w-]+): (#[0-9a-f]+)", body))
    for name, body in zip(("light", "dark"), re.findall(r":root[^{]*\{([^}]*)\}", CSS), strict=True)
}
# Of linear RGB; Machado, Oliveira and Fernandes 2009, severity 1.
EYES = {
    "usual": np.eye(3),
    "no red": [
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998],
    ],
    "no green": [
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881],
    ],
    "no blue": [
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039],
    ],
}  # fmt: skip
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = np.array([0.9505, 1.0, 1.089])
APART = 30.0  # CIE 1976; one looks like the other below some ten


def linear(colour: str) -> Array:
    """A colour of the style sheet as linear RGB, shape (3,)."""
    digits = colour.removeprefix("#")
    digits = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
    part = np.array([int(digits[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def lab(rgb: Array) -> Array:
    ratio = XYZ @ np.clip(rgb, 0.0, 1.0) / WHITE
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one: Array, other: Array) -> float:
    """As WCAG has it."""
    dark, light = sorted((XYZ[1] @ one, XYZ[1] @ other))
    return float((light + 0.05) / (dark + 0.05))


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("eyes", EYES)
def test_implement_and_the_states_of_the_track_are_apart(theme: str, eyes: str) -> None:
    observed = {name: lab(np.asarray(EYES[eyes]) @ linear(value)) for name, value in THEMES[theme].items()}
    for other in ("q0", "q1", "q2", "tractor", "event", "grid"):
        assert np.linalg.norm(observed["implement"] - observed[other]) > APART, other


@pytest.mark.parametrize("theme", THEMES)
def test_whatever_is_drawn_stands_out_from_its_ground(theme: str) -> None:
    panel = linear(THEMES[theme]["panel"])
    for name in ("implement", "tractor", "q0", "q1", "q2", "trace", "event"):
        assert contrast(linear(THEMES[theme][name]), panel) > 3.0, name


def test_the_measure_tells_what_looks_alike() -> None:
    """Red and green of one lightness: apart to most, not to who sees no green."""
    red, green = linear("#a05030"), linear("#657a2a")
    apart = [
        np.linalg.norm(lab(np.asarray(eye) @ red) - lab(np.asarray(eye) @ green)) for eye in EYES.values()
    ]
    assert apart[0] > APART and min(apart) < APART / 2
    assert all(contrast(linear(a), linear(b)) >= 1.0 for a, b in combinations(("#000", "#fff", "#777"), 2))
    assert contrast(linear("#000"), linear("#fff")) == pytest.approx(21.0)
