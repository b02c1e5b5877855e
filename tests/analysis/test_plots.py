"""Figures: the same bytes each time, and named panels."""

from pathlib import Path

import pytest

from studies.dissertation.figures import DRAWINGS
from tilth.analysis import plots


def test_a_figure_drawn_twice_has_the_same_bytes(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("one.svg", "two.svg")]
    for path in paths:
        with plots.look():
            plots.save(DRAWINGS["figure-5-8"](), path)
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize("name", ["figure-3-6", "figure-3-7", "figure-5-3", "figure-5-6", "figure-5-9"])
def test_each_panel_is_named(name: str) -> None:
    with plots.look():
        figure = DRAWINGS[name]()
    for axes in figure.axes:
        assert axes.lines
        assert axes.get_xlabel() or len(figure.axes) > 3
    assert any(axes.get_ylabel() for axes in figure.axes)
