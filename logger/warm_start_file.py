"""`<log folder>/<machine>+<implement>.warm.json`: what a run has learned, for the next one.

It belongs to a machine as its file describes it: where a part of that has changed, what was learned before is
of another rig. What a run takes from it stands as the first state in its log. Values accepted of a tractor
that pulls several implements stand in `<machine>.tractor.json` as well: they hold with each of them.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from tilth.estimator.diagnosis import watch
from tilth.estimator.diagnosis.watch import Moved
from tilth.estimator.methods import place
from tilth.estimator.rig.numbers import DRAWBAR
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.estimator.warm_start import SavedPosterior
from tilth.logger.guarded_fold import FIELD_MAP
from tilth.logger.log import whole_file
from tilth.schemas.flow import Accepted, Carried, EventKind
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, Report, notice, reasoned
from tilth.schemas.reasons import Reason
from tilth.schemas.sentences import notice_sentence

FORMAT: Final = 5
SECTIONS: Final = ("tractor", "implement", "tyres", "receiver", "wheel_angle")
SOILS: Final = SECTIONS[:3]  # of which a map of a field is
MAKES_ONE: Final = "`tilth map DIR --out FILE.json` makes one"
CLOCK_IS_WRONG_S: Final = 86_400.0  # taken for the time between where the clock has gone back

Warm = Callable[
    [
        Mapping[str, SavedPosterior], float, int, Sequence[Accepted], Sequence[Moved],
        tuple[SavedPosterior, float] | None, Carried | None,
    ],
    dict[str, Reason | None],
]  # fmt: skip
"""GuardedFold.warm."""


class KeptRun(NamedTuple):
    """What earlier runs have left."""

    learned: dict[str, SavedPosterior]  # by method
    elapsed_s: float  # since then
    accepted: list[Accepted]  # in place of values of the machine file
    moved: list[Moved]  # found, and neither accepted nor put back
    told: list[Notice]  # the same
    carried: Carried | None  # by the implement


class NotUsable(Exception):
    """What is kept cannot be used; one sentence that says why."""


def path_of(folder: Path, machine: Machine) -> Path:
    """Where what the estimators learned of a machine is stored, in the log folder."""
    return folder / f"{machine.rig}.warm.json"


def tractor_path(folder: Path, machine: Machine) -> Path | None:
    """Where values accepted of the tractor are stored; None where one file is of all."""
    return folder / f"{machine.name}.tractor.json" if machine.implement.name else None


def tractor_text(machine: Machine, accepted: Sequence[Accepted]) -> str:
    """What is to be written there. machine: as its file describes it."""
    own = [one for one in accepted if _of_tractor(one)]
    plain = {"format": FORMAT, "sections": _of_the_tractor(machine), "accepted": to_json_data(own)}
    return json.dumps(plain, indent=1)


def _of_tractor(accepted: Accepted) -> bool:
    return accepted.what != DRAWBAR and "implement" not in accepted.what


def _accepted_of_tractor(path: Path | None, machine: Machine, report: Report) -> list[Accepted]:
    """As stored with whichever implement."""
    try:
        plain = json.loads(whole_file.read(path)) if path is not None else {}
        if not plain or plain["format"] != FORMAT or plain["sections"] != _of_the_tractor(machine):
            return []
        own: list[Accepted] = from_json_data(list[Accepted], plain["accepted"])
        return own
    except FileNotFoundError:
        return []
    except Exception as error:  # anything may stand there, and a run begins whatever it is
        why = f"{path} is damaged ({error!r:.200})"
        report(EventKind.WARM_START, notice(NoticeCode.LEARNED_REFUSED, why=why))
        return []


def _of_the_tractor(machine: Machine) -> dict[str, str]:
    receivers = [one for one in machine.receiver if one.mount.body == "tractor"]
    return _digests(
        machine.model_copy(update={"receiver": receivers}), ("tractor", "receiver", "wheel_angle")
    )


def text_of(
    machine: Machine, learned: dict[str, SavedPosterior], utc_ns: int, accepted: Sequence[Accepted] = (),
    moved: Sequence[Moved] = (), carried: Carried | None = None,
) -> str:  # fmt: skip
    """What is to be written. machine: as its file describes it, without what has been accepted."""
    plain = {
        "format": FORMAT,
        "machine": machine.name,
        "utc_ns": utc_ns,
        "sections": _digests(machine),
        "methods": to_json_data(learned),
        "accepted": to_json_data(list(accepted)),
        "moved": to_json_data(list(moved)),
        "carried": to_json_data(carried),
    }
    return json.dumps(plain, indent=1)


def read(path: Path, machine: Machine, utc_ns: int, sections: Sequence[str] = SECTIONS) -> KeptRun | None:
    """What was kept of a machine as these sections of its file describe it; None where nothing was. Raises
    NotUsable."""
    try:
        plain = json.loads(whole_file.read(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise NotUsable(f"{path} {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise NotUsable(f"{path} cannot be read ({error})") from None
    if not isinstance(plain, dict) or "format" not in plain:
        raise NotUsable(f"{path} is another kind of file")
    try:
        if plain["format"] != FORMAT:
            raise NotUsable(f"{path} is of another version of tilth")
        now, then = _digests(machine), plain["sections"]
        changed = [name for name in sections if now[name] != then.get(name)]
        learned = from_json_data(dict[str, SavedPosterior], plain["methods"])
        elapsed_s = (utc_ns - _time_ns(plain["utc_ns"])) * 1e-9
        accepted = from_json_data(list[Accepted], plain.get("accepted", []))
        moved = [watch.carried(machine, m) for m in from_json_data(list[Moved], plain.get("moved", []))]
        carried = from_json_data(Carried | None, plain.get("carried"))
        told = [reasoned(one.diagnosis.reason, NoticeCode.MOVED_EARLIER) for one in moved]
        for earlier in told:
            notice_sentence(earlier)  # what has no words is damaged
    except NotUsable:
        raise
    except Exception as error:  # anything may stand there, and a run begins whatever it is
        raise NotUsable(f"{path} is damaged ({error!r:.200})") from None
    if changed:
        parts = " and ".join(f"[{name}]" for name in changed)
        raise NotUsable(f"{parts} of the machine file changed since {path} was written")
    return KeptRun(
        learned, elapsed_s if elapsed_s >= 0.0 else CLOCK_IS_WRONG_S, accepted, moved, told, carried
    )


def _time_ns(told: int) -> int:
    """Raises ValueError where it is none."""
    if not -1 < told < 1 << 63:
        raise ValueError(f"no time: {told}")
    return int(told)


def _digests(machine: Machine, of: Sequence[str] = SECTIONS) -> dict[str, str]:
    """Section -> digest of what it says, defaults included, and without what an implement is called."""

    def digest(section: Any) -> str:
        called = {"name", "names"} if section == [machine.implement] else None
        plain = [one.model_dump(mode="json", exclude=called) for one in section]
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]

    sections = {name: getattr(machine, name) for name in of}
    return {name: digest(s if isinstance(s, (list, tuple)) else [s]) for name, s in sections.items()}


def take_up(path: Path, machine: Machine, t_ns: int, warm: Warm, report: Report) -> bool:
    """Go on from what earlier runs have learned, and a map of the field tells, and say what became of it.
    Whether anything was used."""
    found, field_map = _kept(path, machine, t_ns, report), None
    if machine.estimation.field_map is not None:
        try:
            field_map = map_of(Path(machine.estimation.field_map), machine, t_ns)
        except NotUsable as why_not:
            report(EventKind.WARM_START, notice(NoticeCode.LEARNED_REFUSED, why=str(why_not)))
    of_tractor = _accepted_of_tractor(tractor_path(path.parent, machine), machine, report)
    before = [] if found is None else found.accepted
    if later := [one for one in of_tractor if one not in before]:  # with another implement
        accepted = sorted([*before, *later], key=lambda one: one.t_ns)
        found = (found or KeptRun({}, 0.0, [], [], [], None))._replace(accepted=accepted, learned={})
    if found is None:
        if field_map is None:
            return False
        found = KeptRun({}, 0.0, [], [], [], None)
    refusals = warm(
        found.learned, found.elapsed_s, t_ns, found.accepted, found.moved, field_map, found.carried
    )
    used = [method for method, refusal in refusals.items() if refusal is None and method in found.learned]
    for method, refusal in refusals.items():
        if refusal is not None:
            report(EventKind.WARM_START, reasoned(refusal, NoticeCode.METHOD_REFUSED, method=method))
    if used:
        resumed = notice(NoticeCode.RESUMED, methods=", ".join(used), hours=found.elapsed_s / 3600.0)
        report(EventKind.WARM_START, resumed)
    if field_map is not None and refusals.get(FIELD_MAP) is None:
        report(EventKind.WARM_START, notice(NoticeCode.FIELD_MAP, hours=field_map[1] / 3600.0))
    for one in found.accepted:
        report(EventKind.ACCEPTED, notice(NoticeCode.ACCEPTED_EARLIER, what=one.what))
    for earlier in found.told:
        report(EventKind.MOVED, earlier)
    return bool(used or found.accepted or found.moved or field_map)


def _kept(path: Path, machine: Machine, t_ns: int, report: Report) -> KeptRun | None:
    """What can be used; what cannot is told."""
    try:
        return read(path, machine, t_ns)
    except NotUsable as why_not:
        report(EventKind.WARM_START, notice(NoticeCode.LEARNED_REFUSED, why=str(why_not)))
        return None


def map_of(path: Path, machine: Machine, utc_ns: int) -> tuple[SavedPosterior, float]:
    """The map of a field, and its age, s. Raises NotUsable."""
    try:
        found = read(path, machine, utc_ns, SOILS)
    except NotUsable as why_not:
        raise NotUsable(f"[estimation] field_map: {why_not}; {MAKES_ONE}") from None
    if found is None or place.METHOD not in found.learned:
        what = "is not there" if found is None else "holds no map"
        raise NotUsable(f"[estimation] field_map: {path} {what}; {MAKES_ONE}")
    return found.learned[place.METHOD], found.elapsed_s
