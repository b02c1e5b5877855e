"""Figures of a season: what their axes show."""

import matplotlib
import numpy as np
import pytest

from tilth.analysis.report.figure_look import LOOK
from tilth.analysis.report.season_figures import MOST_DAYS_NAMED, calendar, soils


def test_the_calendar_adds_up_the_machines_of_a_day_and_names_few_days() -> None:
    days = [f"2026-05-{day:02d}" for day in range(1, 31)]
    data = {"days": days, "rigs": [{"name": name, "hours": [2.0] * 30} for name in ("one", "two")]}
    with matplotlib.rc_context(LOOK):
        (axes,) = calendar(data).axes
    top = axes.transData.transform((0, 4.0))[1]
    assert max(bar.get_window_extent().y1 for bar in axes.patches) == pytest.approx(top)
    assert len(axes.get_xticks()) <= MOST_DAYS_NAMED


def test_soils_have_a_panel_for_each_stiffness_in_the_order_of_driving() -> None:
    points = [{"at": k, "low": 8e4, "value": 1e5 + 1e3 * k, "high": 1.2e5} for k in range(5)]
    data = {"parameters": {"C_af": points, "C_ai": points[:2]}, "days": [{"day": "2026-05-01", "at": 0}]}
    with matplotlib.rc_context(LOOK):
        panels = soils(data).axes
    assert [panel.get_ylabel() for panel in panels] == ["C_αf, kN/rad", "C_αi, kN/rad"]
    shown = np.asarray(panels[0].lines[0].get_ydata(), dtype=np.float64)
    np.testing.assert_allclose(shown, np.arange(100.0, 105.0))
