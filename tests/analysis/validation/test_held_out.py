"""Predictions of runs that were not fitted: what was learned predicts better, each subset has its row."""

from typing import Any

import numpy as np
import pytest
from logs import MACHINE
from recorded import STEPS, recorded, shared_cache

import tilth.analysis
from studies.dissertation import chapter7
from tilth.analysis.fit.fitting import Fitted, choose, driven_of, fit_all
from tilth.analysis.report.document import plain
from tilth.analysis.validation import held_out
from tilth.analysis.validation.held_out import Subset, predictable, subsets
from tilth.analysis.validation.validate import hold_out
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import SIX
from tilth.schemas.flow import PARAMETERS
from tilth.simulator.tractor import draw


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    (run,) = tilth.analysis.open(recorded().parts)
    return fit_all(choose([run]), jobs=2, cache=shared_cache())


@pytest.fixture(scope="module")
def table(fitted: Fitted) -> tuple[Subset, ...]:
    return hold_out(fitted, shared_cache())


@pytest.mark.long
def test_every_subset_over_every_run(fitted: Fitted, table: tuple[Subset, ...]) -> None:
    ids = [wanted.id for wanted in fitted.wanted]
    assert [row.fitted for row in table] == [(), (ids[0],), (ids[1],), tuple(ids)]
    for row in table:
        assert [cell.run for cell in row.cells] == ids
        assert [cell.held_out for cell in row.cells] == [id not in row.fitted for id in ids]


@pytest.mark.long
def test_what_was_learned_predicts_better_than_the_machine_file(table: tuple[Subset, ...]) -> None:
    """The path of one run alone may be as good by chance, since it drifts by the zero of the wheel angle."""
    untaught, *_, taught = table
    for body in ("tractor_m", "implement_m"):
        before_m, after_m = (sum(getattr(cell, body) for cell in row.cells) for row in (untaught, taught))
        assert after_m < 0.5 * before_m
    for before, after in zip(untaught.cells, taught.cells, strict=True):
        assert after.gain > 10.0 and before.gain == 0.0
        assert after.fit_percent["yaw_rate"] > before.fit_percent["yaw_rate"]
        assert set(after.horizon_rms) == {"1", "5"}
        assert after.horizon_rms["1"]["yaw_rate"] <= 1.05 * before.horizon_rms["1"]["yaw_rate"]
    for row in table:
        for cell in row.cells:
            assert cell.tractor_m_low <= cell.tractor_m <= cell.tractor_m_high
            assert cell.implement_m_low <= cell.implement_m <= cell.implement_m_high


@pytest.mark.long
def test_wrong_tyres_predict_worse(fitted: Fitted) -> None:
    own = fitted.fits[0]
    run = predictable(MACHINE, "one", driven_of(fitted.wanted[0], shared_cache()), own.mean)
    assert run is not None
    wrong = own.mean.copy()
    wrong[0] += 0.3
    good, bad = (held_out.table(MACHINE, [run], {("x",): point})[1].cells[0] for point in (own.mean, wrong))
    assert good.tractor_m < 0.3 and bad.tractor_m > 3.0 * good.tractor_m and bad.gain < good.gain


@pytest.mark.long
def test_the_way_is_that_of_the_table(fitted: Fitted, table: tuple[Subset, ...]) -> None:
    run = predictable(MACHINE, "one", driven_of(fitted.wanted[0], shared_cache()), fitted.fits[0].mean)
    assert run is not None
    tractor, implement = held_out.way(MACHINE, run, fitted.fits[1].mean)
    cell = table[2].cells[0]  # the second run's parameters over the first run
    for path, rms in ((tractor, cell.tractor_m), (implement, cell.implement_m)):
        apart = np.sum((path[:, 1:3] - path[:, 3:]) ** 2, axis=1)
        assert np.sqrt(np.mean(apart)) == pytest.approx(rms, rel=1e-9)
        assert np.all(np.diff(path[:, 0]) > 0.0) and path[-1, 0] > 15.0
    there = [np.interp(tractor[:, 0], implement[:, 0], implement[:, k]) for k in (1, 2)]
    behind = np.hypot(*(tractor[:, 1:3].T - there))[5:-5]  # where both have begun and none has ended
    assert np.all((behind > 5.0) & (behind < 7.0))


@pytest.mark.long
def test_what_is_too_short_cannot_be_predicted(fitted: Fitted) -> None:
    driven = driven_of(fitted.wanted[0], shared_cache())
    assert predictable(MACHINE, "x", driven[:30], fitted.fits[0].mean) is None
    assert predictable(MACHINE, "x", (), fitted.fits[0].mean) is None


@pytest.mark.long
def test_numbers_that_do_not_exist_are_none(table: tuple[Subset, ...]) -> None:
    rows: list[dict[str, Any]] = plain(table)
    assert rows[0]["fitted"] == [] and set(rows[1]["cells"][0]) >= {"run", "held_out", "tractor_m", "gain"}
    assert "NaN" not in repr(rows) and "nan" not in repr(rows)


@pytest.mark.parametrize(("count", "rows"), [(1, 1), (3, 7), (6, 63), (7, 15), (9, 19)])
def test_subsets(count: int, rows: int) -> None:
    found = subsets([str(k) for k in range(count)])
    assert len(found) == rows == len(set(found)) and len(found[-1]) == count


@pytest.mark.long
def test_a_group_of_the_dissertations_runs_is_the_table(fitted: Fitted, table: tuple[Subset, ...]) -> None:
    rows: Any = chapter7.group(fitted, shared_cache())["subsets"]
    assert [row["runs"] for row in rows] == [[], [1], [2], [1, 2]] and "values" not in rows[0]
    for row, subset in zip(rows, table, strict=True):
        assert row["cells"] == [[cell.tractor_m, cell.implement_m] for cell in subset.cells]
    assert fitted.joint is not None
    assert rows[3]["values"][0] == pytest.approx(np.exp(fitted.joint.mean[0])) and rows[3]["p"] > 0.01
    single = fitted.fits[1].estimates["pem"].parameters[1]
    assert (rows[2]["values"][1], rows[2]["sds"][1]) == (single.value, single.sd)


def test_nothing_told_nothing_held_out() -> None:
    assert hold_out(Fitted((), (), (), None, None)) == ()


@pytest.mark.long
def test_the_fit_comes_near_the_truth(fitted: Fitted) -> None:
    assert fitted.joint is not None
    truth = np.log([draw(MACHINE, 3, STEPS)[name] for name in PARAMETERS])
    sds = np.sqrt(np.diag(fitted.joint.covariance))[SIX]
    assert np.all(np.abs(fitted.joint.mean[SIX] - truth) < 3.5 * sds)
    assert np.all(sds < 0.6 * unknowns.prior(MACHINE)[1][SIX])
