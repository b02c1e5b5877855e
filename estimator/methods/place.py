"""A memory by place: what windows of driving have told of the soil where they were, for where the rig is now.

It learns nothing from the record itself: each window that pem or rows have fitted leaves what it *added* to
what was known before it, with the way that the axles went. What is known before never comes in, so no second
of driving counts twice, and a second pass does not take up the first. The field of soil that these tell of
(filters/soil_field.py) gives the six under the axles now, each at its own axle's place. pem and rows take
nothing from here.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from tilth.estimator.filters import soil_field, unknowns
from tilth.estimator.filters.soil_field import (
    AXLES,
    SOIL_FIELD,
    AskedGround,
    SoilMemory,
    SoilWindow,
    WorkedPoint,
)
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import SIX, Vector
from tilth.estimator.methods import pem, rows
from tilth.estimator.pose.geometry import to_degrees, to_plane
from tilth.estimator.record.record import Record
from tilth.estimator.results.method_state import MethodState, SixState, is_due, step_clock
from tilth.estimator.results.recommend import PATCHY
from tilth.estimator.results.reporting import REPORTING, six_parameter_estimate
from tilth.estimator.rig.geometry import wrap
from tilth.estimator.state_json import NOT_STORED, Shape
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Estimate, EventKind, Pose, SoilPlace
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice
from tilth.schemas.reasons import Code
from tilth.schemas.tolerances import MADE

Array = NDArray[np.float64]

METHOD: Final = "place"


@dataclass(frozen=True, slots=True)
class PlaceTuning:
    """How much is kept."""

    most_windows: int = tuned(32, "stretches", "that are kept; beyond, the two that are nearest become one")
    track_ns: int = tuned(2_000_000_000, "ns", "between two places of the way that is kept")
    lead_ns: int = tuned(10_000_000_000, "ns", "at the end of a row, which a window of the turn may have too")
    near_m: float = tuned(300.0, "m", "from a way of an earlier run: further off is another field")
    track: int = tuned(
        600, "positions", "of the way, 20 min: a block of rows, and the time until it is fitted"
    )
    way: int = tuned(1500, "positions", "of corners of the worked way: some hundred passes")
    straight_m: float = tuned(0.3, "m", "off the line to the next: a place of the worked way is no corner")
    turned: float = tuned(math.radians(120.0), "rad", "from the heading of a pass: the next one begins")
    patchy: float = tuned(
        0.95, "1", "probability of patches with which a change from place to place is no news"
    )
    known_sd: float = tuned(0.15, "1", "of the factor common to stiffnesses, with which a place is known")
    unexpected: float = tuned(1e-4, "1", "probability of what a window tells: the soil has changed in time")
    doubted: float = tuned(1e-2, "1", "probability of it, if pem finds that the soil has changed")


PLACE: Final = PlaceTuning()


@dataclass(frozen=True, slots=True)
class TrackPoint:
    """Where the axles were."""

    t_ns: int
    axles: Annotated[Array, Shape((3, 2))]  # north and east, m
    worked: Annotated[Array, Shape((3,))]  # 1 where the ground had been worked in a pass before, else 0


@dataclass(slots=True)
class PlaceState(MethodState):
    """Arrays in the order of unknowns.NAMES; times ns. Positions, m, in the plane of the poses. `windows` is
    never changed in place: `soil` is of the list that it was derived from."""

    prior_mean: Vector
    prior_sd: Vector
    windows: list[SoilWindow] = field(default_factory=list)
    track: deque[TrackPoint] = field(default_factory=lambda: deque(maxlen=PLACE.track))
    way: deque[WorkedPoint] = field(default_factory=lambda: deque(maxlen=PLACE.way))
    axles: Annotated[Array, Shape((3, 2))] | None = None  # where they are now
    origin_deg: tuple[float, float] | None = None  # latitude and longitude, of the plane
    rows_ns: list[tuple[int, int]] = field(default_factory=list)  # of the rows that were fitted last
    passing: int = 0  # number of the pass
    heading: float = 0.0  # rad, of the pass
    window_s: float = 0.0
    has_number: list[bool] = field(default_factory=lambda: [False] * 6)
    map_ns: int = 0  # when the field's map, and all else of earlier runs, was told last
    earlier: SoilMemory | None = field(default=None, metadata=NOT_STORED)  # of windows of earlier runs
    soil: SoilMemory | None = field(default=None, metadata=NOT_STORED)


def initial(machine: Machine) -> PlaceState:
    """The state before any data, at the priors of the machine file."""
    return PlaceState(*unknowns.prior(machine))


def take(state: PlaceState, machine: Machine, pose: Pose, segment: Any) -> Estimate | None:
    """Take the way of one pose; an estimate each REPORTING.publish_ns."""
    axles = _axles(machine, pose)
    if axles is not None:
        _move_origin(state, (pose.origin_latitude_deg, pose.origin_longitude_deg))
        state.axles = axles
        if exceeds(abs(wrap((pose.tractor.heading or 0.0) - state.heading)), PLACE.turned, MADE):
            state.passing, state.heading = state.passing + 1, pose.tractor.heading or 0.0
        if not state.track or pose.t_ns - state.track[-1].t_ns >= PLACE.track_ns:
            state.track.append(TrackPoint(pose.t_ns, axles, worked(state, machine, axles)))
            if machine.implement.working_width:
                _lengthen(state.way, WorkedPoint(state.passing, axles[-1]))
    if not is_due(state, pose.t_ns, REPORTING.publish_ns):
        return None
    return estimate(state, machine, pose.t_ns)


def _axles(machine: Machine, pose: Pose) -> Array | None:
    """North and east of the middles of front, rear and implement's axle, (3, 2), m; None where unknown."""
    ahead = (machine.tractor.a.value, -machine.tractor.b.value, -machine.implement.e.value)
    places = []
    for body, metres in zip((pose.tractor, pose.tractor, pose.implement), ahead, strict=True):
        if body.x is None or body.y is None or body.heading is None:
            return None
        places.append((body.x + metres * math.cos(body.heading), body.y + metres * math.sin(body.heading)))
    return np.array(places)


def worked(state: PlaceState, machine: Machine, axles: Array) -> Array:
    """1 where the implement has worked the ground under an axle in a pass before, else 0, (3,). What it does
    there nobody tells: that it is let down, not lifted, is taken for granted."""
    places = np.array([point.place for point in state.way]).reshape(-1, 2)
    passing = np.array([point.passing for point in state.way])
    leg = (passing[1:] == passing[:-1]) & (passing[1:] != state.passing)
    off = _off_legs(axles[:, None], places[:-1][leg], np.diff(places, axis=0)[leg])
    half = machine.implement.working_width / 2.0
    return np.asarray(off.min(axis=1, initial=math.inf) < half, np.float64)


def _off_legs(places: Array, begin: Array, along: Array) -> Array:
    """How far places, (…, 2), are from the lines that begin there and go so far, m."""
    share = np.sum((places - begin) * along, axis=-1) / np.maximum(np.sum(along * along, axis=-1), 1e-9)
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(places - nearest, axis=-1))


def _lengthen(way: deque[WorkedPoint], point: WorkedPoint) -> None:
    """The way goes on to a point; the one before is left out where it is no corner."""
    if len(way) > 1 and way[-2].passing == way[-1].passing == point.passing:
        begin = way[-2].place
        if _off_legs(way[-1].place, begin, point.place - begin) < PLACE.straight_m:
            way.pop()
    way.append(point)


def axles_ahead(state: PlaceState, machine: Machine, x: float, y: float) -> Array:
    """Where the axles are, (3, 2), as the rear one is at a place and all in line as the tractor heads now."""
    return np.array([x, y]) + axles_in_line(machine, state.heading)


def axles_in_line(machine: Machine, heading: float) -> Array:
    """North and east of front, rear and implement's axle from the rear one, (3, 2), m, all in line."""
    a, b, c = machine.tractor.a.value, machine.tractor.b.value, machine.tractor.c.value
    behind = np.array([a + b, 0.0, b - c - machine.implement.d.value - machine.implement.e.value])
    return np.asarray(behind[:, None] * np.array([math.cos(heading), math.sin(heading)]), np.float64)


def _move_origin(state: PlaceState, origin_deg: tuple[float, float]) -> None:
    """What is kept, in the plane of another origin."""
    before, state.origin_deg = state.origin_deg, origin_deg
    if before is None or before == origin_deg:
        return

    def moved(places: Array) -> Array:
        flat = [to_plane(origin_deg, *to_degrees(before, x, y)) for x, y in places.reshape(-1, 2).tolist()]
        return np.array(flat).reshape(places.shape)

    windows = [replace(window, path=moved(window.path)) for window in state.windows]
    # A plane does not reach round the Earth.
    state.windows = [window for window in windows if np.all(np.isfinite(window.path))]
    way = [replace(point, place=moved(point.place)) for point in state.way]
    state.way = deque((p for p in way if np.all(np.isfinite(p.place))), PLACE.way)
    state.track.clear()


def records_of(job: Any) -> list[Record]:
    """Of a job of pem or of rows."""
    return job.rows if isinstance(job, rows.Job) else [job.record]


def windows_of(state: PlaceState, job: Any, made: Any) -> list[SoilWindow]:
    """What another method's fit has told, and where: one of a window of pem, one for each piece of a row.
    None of what nobody knows where it was."""
    if not isinstance(made, pem.Fit | rows.Fit) or made.told is None:
        return []
    if isinstance(made, rows.Fit):
        method, pieces = rows.METHOD, made.pieces
    else:
        record = job.record
        method, pieces = pem.METHOD, (rows.ToldPiece(record.t_ns, record.end_ns, made.told),)
    windows = []
    for piece in pieces:
        within = [p for p in state.track if piece.begin_ns <= p.t_ns <= piece.end_ns]
        if within:
            shares = np.mean([p.worked for p in within], axis=0)
            path = _evenly(np.array([p.axles for p in within]))
            windows.append(SoilWindow(method, piece.begin_ns, state.passing, path, piece.told, worked=shares))
    return windows


def in_rows(state: PlaceState, window: SoilWindow, records: Sequence[Record]) -> list[tuple[int, int]]:
    """Begin and end of the rows fitted last: these records, where the window is of rows, ns."""
    if window.method == rows.METHOD:
        return [(record.t_ns, record.end_ns) for record in records]
    return state.rows_ns


def beside(
    windows: Sequence[SoilWindow], window: SoilWindow, rows_ns: Sequence[tuple[int, int]]
) -> list[SoilWindow] | None:
    """Those that stay beside a window, the first of a fit; None where it is left out itself. A second of
    driving informs the six once: in a row by `rows`, whichever of the two is told first. rows_ns: as of
    in_rows."""
    if window.method == rows.METHOD:
        return [w for w in windows if not _is_of(w, rows_ns)]
    again = window.method, window.begin_ns
    kept = [w for w in windows if (w.method, w.begin_ns) != again]
    return None if _is_of(window, rows_ns) else kept


def learn(state: PlaceState, job: Any, made: Any) -> bool:
    """Take what another method's fit has told. Returns whether a change of soil that it found was foreseen:
    it is no more than the memory expected of the place."""
    windows = windows_of(state, job, made)
    if not windows:
        return False
    records = records_of(job)
    state.rows_ns = in_rows(state, windows[0], records)
    kept = beside(state.windows, windows[0], state.rows_ns)
    if kept is None:
        return False
    before = _soil(state) if len(kept) == len(state.windows) else SoilMemory(kept, state.prior_sd)
    epoch = kept[-1].epoch if kept else 0
    windows = [replace(window, epoch=epoch) for window in windows]
    after = SoilMemory([*kept, *windows], state.prior_sd)
    window = replace(windows[0], told=made.told, path=np.concatenate([one.path for one in windows]))
    likely, of_pem = before.surprise(after), isinstance(made, pem.Fit) and made.changed
    foreseen = bool(kept) and exceeds(likely, PLACE.doubted) and _expects_change(state, kept, window)
    if exceeds(PLACE.unexpected, likely):
        if not of_pem:  # else it is told by pem
            state.events.append((EventKind.SOIL_CHANGE, _changed(before, window)))
        windows = [replace(one, epoch=epoch + 1) for one in windows]
        after = SoilMemory([*kept, *windows], state.prior_sd)
    state.windows, state.soil = list(after.windows), after
    while len(state.windows) > PLACE.most_windows:
        state.windows = merged_nearest(state.windows, state.rows_ns)
    state.informed_ns = job.closed_ns
    state.window_s += sum(len(record.ticks) for record in records) * DT
    return foreseen


def _expects_change(state: PlaceState, kept: Sequence[SoilWindow], window: SoilWindow) -> bool:
    """Whether soil on its way is known, or is known to differ from place to place."""
    soil = _between_windows(kept, state.prior_sd)
    there = soil.at(window.path, AskedGround(window.begin_ns, window.worked))
    return exceeds(soil.patchy, PLACE.patchy) or exceeds(PLACE.known_sd, _common_sd(there))


def expects(state: PlaceState, logs: Array) -> bool:
    """Whether this place is known, and a change to what a method finds here now is no news. logs: of the six
    as the method has them while they are still roughly known, (n,)."""
    if state.axles is None or not state.windows:
        return False
    there = _between_windows(state.windows, state.prior_sd).at(state.axles, _asked(state))
    off = float(np.mean((logs[SIX] - state.prior_mean[SIX] - there.mean)[:AXLES]))
    sd = _common_sd(there)
    return exceeds(PLACE.known_sd, sd) and exceeds(2.0 * math.hypot(sd, PLACE.known_sd), abs(off))


def _between_windows(windows: Sequence[SoilWindow], prior_sd: Vector) -> SoilMemory:
    """What windows tell beside each other. Whether a change is news is asked of this: that soil was alike
    along a way says nothing of what it becomes there later."""
    return SoilMemory([replace(w, told=replace(w.told, patches=0.0)) for w in windows], prior_sd)


def _common_sd(there: soil_field.At) -> float:
    """Of the mean of the three stiffnesses' logarithms."""
    return math.sqrt(float(there.covariance[:AXLES, :AXLES].mean()))


def _changed(before: SoilMemory, window: SoilWindow) -> Notice:
    """By which factors a window tells otherwise than was expected of its way."""
    expected = before.at(window.path, AskedGround(window.begin_ns, window.worked))
    weak = np.diag(before.prior_sd**-2.0)
    found = np.linalg.inv(window.told.information + weak)
    variances = np.diag(found) + np.diag(expected.covariance)
    return pem.soil_changed(found @ window.told.vector - expected.mean, np.sqrt(variances))


def _is_of(window: SoilWindow, rows_ns: Sequence[tuple[int, int]]) -> bool:
    """Whether a window is of the driving in these rows: a piece of them, or a window of the same seconds.
    That of the turn behind a row is not, though it begins before the wheels turn."""
    lead_ns = 0 if window.method == rows.METHOD else PLACE.lead_ns
    return any(begin <= window.begin_ns < end - lead_ns for begin, end in rows_ns)


def _evenly(path: Array) -> Array:
    """SOIL_FIELD.points of a path, (n, 3, 2)."""
    return path[np.linspace(0, len(path) - 1, SOIL_FIELD.points).round().astype(np.int64)]


def merged_nearest(
    windows: Sequence[SoilWindow], rows_ns: Sequence[tuple[int, int]] = ()
) -> list[SoilWindow]:
    """Of two windows of a method that were nearest to each other, one; of before and after a change in time
    only where there are no others. The last one stays. rows_ns: pieces of these rows only with each other,
    since a later fit tells all of them again."""
    old = windows[:-1]
    epochs = np.array([w.epoch for w in old])
    kinds = np.array([f"{w.method}, told again: {_is_of(w, rows_ns)}" for w in old])
    places = np.array([w.path[:, 1] for w in old]).transpose(1, 0, 2)
    points, count = places.shape[:2]
    squared = cdist(places.reshape(-1, 2), places.reshape(-1, 2), "sqeuclidean")
    # How far ways are from each other: each place to the nearest of the other.
    nearest = np.sqrt(squared.reshape(points, count, points, count).min(axis=2)).mean(axis=0)
    apart = np.maximum(nearest, nearest.T)
    apart[epochs[:, None] != epochs] += np.max(apart) + 1.0
    apart[(kinds[:, None] != kinds) | np.tri(len(old), dtype=bool)] = np.inf
    first, second = divmod(int(np.argmin(apart)), len(old))
    both = soil_field.merged(old[first], old[second])
    return [both if k == second else w for k, w in enumerate(windows) if k != first]


def estimate(state: PlaceState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns, of where the rig is."""
    return estimate_at(state, machine, t_ns, state.axles, state.has_number)


def estimate_at(
    state: PlaceState, machine: Machine, t_ns: int, axles: Array | None, had: list[bool]
) -> Estimate:
    """The estimate of any place. axles: north and east of each axle, (3, 2), m; None: not known where. had:
    which of the six had a number before; changed in place."""
    mean, covariance = state.prior_mean.copy(), np.zeros((len(state.prior_mean),) * 2)
    covariance[SIX, SIX] = np.diag(state.prior_sd[SIX] ** 2)
    of_place, patchy = None, 0.0
    if axles is not None and state.windows and state.origin_deg is not None:
        soil, asked = _soil(state), AskedGround(t_ns, worked(state, machine, axles))
        there, patchy = soil.at(axles, asked), soil.patchy
        mean[SIX] += there.mean
        covariance[SIX, SIX] = there.covariance + pem.of_masses(np.diag(state.prior_sd**2))[SIX, SIX]
        shares = soil.shares(axles, [window.passing == state.passing for window in soil.windows], asked)
        at = to_degrees(state.origin_deg, *axles[1].tolist())
        of_place = SoilPlace(*at, there.length_m, *shares, tuple(mean[SIX].tolist()))
    learned = SixState(
        mean, covariance, state.prior_mean, state.prior_sd,
        informed_ns=state.informed_ns if of_place else 0, window_s=state.window_s, has_number=had,
    )  # fmt: skip
    excitation = {"windows": float(len(state.windows)), "pass": float(state.passing), PATCHY: patchy}
    made = six_parameter_estimate(
        learned, machine, t_ns, METHOD, covariance[SIX, SIX], Code.NOTHING_FITTED, excitation, None, None
    )
    return replace(made, of_place=of_place)


def elsewhere(state: PlaceState) -> Array:
    """How much more uncertain the six, (6, 6), are here for a method that knows no place."""
    if state.axles is None or not state.windows:
        return np.zeros((6, 6))
    return _soil(state).elsewhere(state.axles, _asked(state))


def _asked(state: PlaceState) -> AskedGround:
    """Of where the rig is now."""
    return AskedGround(worked=state.track[-1].worked) if state.track else AskedGround()


def by_earlier_runs(state: PlaceState, t_ns: int) -> soil_field.At | None:
    """What earlier runs alone tell of where the rig is, as old as it is at t_ns; None on another field than
    theirs."""
    told = [window for window in state.windows if window.passing < 0]
    if state.axles is None or not told:
        return None
    ways = np.concatenate([window.path[:, 1] for window in told])
    if float(np.linalg.norm(ways - state.axles[1], axis=1).min()) > PLACE.near_m:
        return None
    if state.earlier is None or list(map(id, state.earlier.windows)) != list(map(id, told)):
        state.earlier = SoilMemory(told, state.prior_sd)
    return state.earlier.at(state.axles, _asked(state)._replace(t_ns=t_ns))


def add(state: PlaceState, field_map: PlaceState) -> None:
    """Before the first frame: what a season tells of its fields. Of what the rig itself has kept, only what
    is later than that counts beside it: the season may have the same driving."""
    if field_map.origin_deg is None:
        return
    later = [window for window in state.windows if window.begin_ns > field_map.informed_ns]
    if state.origin_deg is not None:
        _move_origin(field_map, state.origin_deg)
    state.origin_deg, state.windows = field_map.origin_deg, [*field_map.windows, *later]
    state.informed_ns = max(field_map.informed_ns, state.informed_ns if later else 0)
    state.map_ns = state.informed_ns


def _soil(state: PlaceState) -> SoilMemory:
    """By the windows that there are now. Another thread may ask too: what it derives from a list of before is
    not taken for that of the next."""
    soil, windows = state.soil, state.windows
    if soil is None or soil.windows is not windows:
        soil = state.soil = SoilMemory(windows, state.prior_sd)
    return soil


def clock_stepped(state: PlaceState, by_ns: int) -> None:
    """The log's clock stepped back: what windows have told stays, where, and how long ago."""
    state.track.clear()
    state.rows_ns.clear()
    state.axles = None
    state.windows = [replace(window, begin_ns=window.begin_ns + by_ns) for window in state.windows]
    state.map_ns += by_ns if state.map_ns else 0
    step_clock(state, by_ns)
