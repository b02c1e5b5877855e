"""Everything that tells whether fitted parameters can be trusted, of what `tilth fit` has fitted."""

from collections.abc import Callable
from pathlib import Path

from tilth.analysis.fit.fitting import Fitted, driven_of
from tilth.analysis.fit.joint import join
from tilth.analysis.validation import held_out
from tilth.analysis.validation.held_out import Predictable, Subset

Progress = Callable[[int, int], None]  # done, of all


def hold_out(
    fitted: Fitted, cache: Path | None = None, progress: Progress = lambda done, of: None
) -> tuple[Subset, ...]:
    """Parameters of every subset of the segments, over every segment; () where none told anything.

    A single segment's parameters are those of its own fit.
    """
    if fitted.linearised is None:
        return ()
    machine = fitted.wanted[0].run.machine
    runs: list[Predictable] = []
    places: dict[str, int] = {}  # id -> which of the linearised
    for at, k in enumerate(fitted.told):
        driven = driven_of(fitted.wanted[k], cache)
        run = held_out.predictable(machine, fitted.wanted[k].id, driven, fitted.fits[k].mean)
        progress(at, len(fitted.told))
        if run is not None:
            runs.append(run)
            places[run.id] = at
    estimates = {}
    for ids in held_out.subsets(list(places)):
        alone = fitted.fits[fitted.told[places[ids[0]]]].mean
        chosen = [places[id] for id in ids]
        estimates[ids] = alone if len(ids) == 1 else join(machine, fitted.linearised, chosen).mean
    return held_out.table(machine, runs, estimates)
