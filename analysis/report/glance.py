"""The run at a glance: when, where, how far, what was alive, what was driven, what happened."""

from collections.abc import Sequence
from typing import Final

from tilth.analysis.report.data import EventFacts, RunFacts
from tilth.analysis.report.document import (
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.gather import CONTRADICTION, SOIL_CHANGE
from tilth.analysis.report.wording import (
    NOTHING,
    clock,
    degrees,
    distance,
    fixed,
    kmh,
    listed,
    many,
    number,
    seconds,
)

_LEAST: Final = 5e-4  # share that one digit after the point shows
MOST_ROWS: Final = 40  # of a table of events; all stand in the JSON
NAMES: Final = {
    "step": "step", "steady_turn": "steady turn", "chirp": "chirp", "random": "random steering",
    "headland_turn": "headland turn", "turn": "turn", "row": "row", "marked": "marked", "given": "given",
}  # fmt: skip
WHO: Final = {
    "tractor_front": "receiver, tractor front", "tractor_rear": "receiver, tractor rear",
    "implement_front": "receiver, implement front", "implement_rear": "receiver, implement rear",
    "wheel_angle": "wheel-angle sensor",
}  # fmt: skip


def glance_section(run: RunFacts, id: str) -> ReportSection:
    """When, where, how far, what was alive, driven and noted."""
    parts: list[Part] = [ReportText(_when(run)), _numbers(run, id)]
    sections = [_sensors(run, id), _map(run, id), _drive(run, id), _segments(run, id), _happened(run, id)]
    return ReportSection(f"{id}-glance", "The run at a glance", tuple(parts), tuple(sections))


def _when(run: RunFacts) -> str:
    start, driving = run["start_utc_s"], run["driving"]
    day = (
        "On a day that the log does not know"
        if start is None
        else clock(start, "On %Y-%m-%d from %H:%M:%S UTC")
    )
    place = ""
    latitude, longitude = driving["latitude_deg"], driving["longitude_deg"]
    if latitude is not None and longitude is not None:
        place = f" at {_side(latitude, 'NS')}, {_side(longitude, 'EW')}"
    note = f" Note: {run['note']}." if run["note"] else ""
    return f"{day}, for {seconds(run['duration_s'])}{place}, with {run['machine']['name']}.{note}"


def _side(angle_deg: float, sides: str) -> str:
    return f"{abs(angle_deg):.5f}° {sides[angle_deg < 0]}"


def _numbers(run: RunFacts, id: str) -> ReportTable:
    d, gaps = run["driving"], run["gaps"]
    share = d["all_receivers_share"]
    lost = f"{many(gaps['count'], 'gap')}, {gaps['all_s']:.1f} s" if gaps["count"] else "none"
    rows = (
        ("length of the run", ReportCell(seconds(run["duration_s"]), run["duration_s"])),
        ("distance driven", ReportCell(distance(d["distance_m"]), d["distance_m"])),
        ("median speed while driving", ReportCell(kmh(d["median_speed_mps"]), d["median_speed_mps"])),
        ("largest speed", ReportCell(kmh(d["largest_speed_mps"]), d["largest_speed_mps"])),
        ("driving", ReportCell(seconds(d["moving_s"]), d["moving_s"])),
        ("of it in reverse", ReportCell(seconds(d["reverse_s"]), d["reverse_s"])),
        ("standing", ReportCell(seconds(d["still_s"]), d["still_s"])),
        ("poses", ReportCell(str(d["poses"]), d["poses"])),
        ("poses with all receivers", ReportCell(_percent(share), share)),
        ("gaps in poses", ReportCell(lost, gaps["all_s"])),
    )
    cells = tuple((ReportCell(name), cell) for name, cell in rows)
    return ReportTable(f"{id}-numbers", "The run in numbers.", ("", "value"), cells)


def _percent(share: float | None) -> str:
    if share is None:
        return NOTHING
    if 0.0 < share < _LEAST:
        return "< 0.1 %"
    if 1.0 - _LEAST < share < 1.0:
        return "> 99.9 %"
    return f"{100 * share:.1f} %" if 0.0 < share < 1.0 else f"{100 * share:.0f} %"


def _sensors(run: RunFacts, id: str) -> ReportSection:
    rows = []
    for one in run["sensors"]:
        longest = one["gaps"]["longest"]
        gap = f"{longest[0]['seconds']:.1f} s at {longest[0]['start_s']:.1f} s" if longest else "none"
        fixes = [f"{name} {_percent(share)}" for name, share in one["fix"].items()]
        rows.append((
            ReportCell(WHO[one["name"]]),
            ReportCell(_percent(one["alive_share"]), one["alive_share"]),
            ReportCell(fixed(one["per_s"], 1), one["per_s"]),
            ReportCell(str(one["gaps"]["count"]), one["gaps"]["count"]),
            ReportCell(gap, longest[0]["seconds"] if longest else None),
            ReportCell(", ".join(fixes) or NOTHING),
        ))  # fmt: skip
    columns = ("sensor", "alive", "per s", "gaps", "longest gap", "fix")
    table = ReportTable(f"{id}-sensors", "Sensors: share of the run in which they gave measurements.",
                        columns, tuple(rows))  # fmt: skip
    return ReportSection(f"{id}-alive", "Sensors", (table,))


def _map(run: RunFacts, id: str) -> ReportSection:
    path = run["curves"]["path"]
    events = numbered_events(run)
    places = [{"number": k, "x": e["x_m"], "y": e["y_m"]} for k, e in events if e["x_m"] is not None]
    changes = [
        {"x": e["x_m"], "y": e["y_m"]}
        for e in run["events"]
        if e["kind"] == SOIL_CHANGE and e["x_m"] is not None
    ]
    described = (
        f"Map with {len(path['segments'])} numbered segments, {many(len(places), 'event')} and "
        f"{many(len(changes), 'change')} of soil; {distance(run['driving']['distance_m'])} were driven."
    )
    figure = ReportFigure(
        f"{id}-path", "path",
        "Paths of the centres of gravity of tractor (line) and implement (dashed). Segments are wide, "
        "coloured by kind and numbered, as far as there is room, as in the table of segments; triangles are "
        "events, diamonds changes of soil.",
        described, path | {"events": places, "soil_changes": changes},
    )  # fmt: skip
    return ReportSection(f"{id}-map", "Map", (figure,))


def _drive(run: RunFacts, id: str) -> ReportSection:
    segments = [{key: one[key] for key in ("number", "kind", "start_s", "end_s")} for one in run["segments"]]
    largest = max((abs(one["largest_angle_rad"]) for one in run["segments"]), default=None)
    described = f"Three curves over {seconds(run['duration_s'])}; {len(segments)} segments are shaded."
    if largest is not None:
        described += f" The largest wheel angle in a segment is {degrees(largest).lstrip('+')}."
    figure = ReportFigure(
        f"{id}-drive", "drive",
        "Wheel angle, speed and articulation over the time of the run, with 95 % bands as far as they are "
        "wider than the line. Segments are shaded and numbered as far as there is room.",
        described, run["curves"]["drive"] | {"segments": segments, "duration_s": run["duration_s"]},
    )  # fmt: skip
    return ReportSection(f"{id}-driving", "Steering and speed", (figure,))


def _segments(run: RunFacts, id: str) -> ReportSection:
    title = "Segments"
    if not run["segments"]:
        text = "No segment was found: no steering at 3.6 km/h or more with receivers that fit, no row."
        return ReportSection(f"{id}-parts", title, (ReportText(text),))
    rows = tuple(
        (
            ReportCell(str(one["number"]), one["number"]),
            ReportCell(NAMES[one["kind"]] + (f": {one['name']}" if one["name"] else "")),
            ReportCell(fixed(one["start_s"], 1), one["start_s"]),
            ReportCell(fixed(one["end_s"], 1), one["end_s"]),
            ReportCell(kmh(one["speed_mps"], ""), one["speed_mps"]),
            ReportCell(degrees(one["largest_angle_rad"]), one["largest_angle_rad"]),
            ReportCell(
                ", ".join(text.removesuffix(" (95 %)") for text in one["tells"]) or "nothing of the six"
            ),
        )
        for one in run["segments"]
    )
    columns = ("segment", "kind", "from, s", "to, s", "speed, km/h", "largest wheel angle", "can tell, 95 %")
    caption = (
        "Segments, times since the run began. The last column: how well a fit of this steering could know a "
        "parameter at best (Cramér–Rao bound at the machine file's values); what is missing cannot be told."
    )
    return ReportSection(f"{id}-parts", title, (ReportTable(f"{id}-segments", caption, columns, rows),))


def numbered_events(run: RunFacts) -> list[tuple[int, EventFacts]]:
    """All events but changes of soil, with the numbers that they have on the map."""
    return list(enumerate((event for event in run["events"] if event["kind"] != SOIL_CHANGE), 1))


def _happened(run: RunFacts, id: str) -> ReportSection:
    parts: list[Part] = []
    numbered = numbered_events(run)
    if numbered:
        parts += _event_table(numbered, id)
    else:
        parts.append(ReportText("There were no marks and no events."))
    parts += _soil_changes(run, id)
    if run["flags"]:
        rows = tuple(
            (
                ReportCell(one["flag"]),
                ReportCell(str(one["poses"]), one["poses"]),
                ReportCell(_percent(one["share"]), one["share"]),
            )
            for one in run["flags"]
        )
        caption = "Flags of poses; docs/notation.md says what each means."
        parts.append(ReportTable(f"{id}-flags", caption, ("flag", "poses", "share"), rows))
    else:
        parts.append(ReportText("No pose has a flag."))
    return ReportSection(f"{id}-happened", "Marks, events and flags", tuple(parts))


def _event_table(numbered: Sequence[tuple[int, EventFacts]], id: str) -> list[Part]:
    rows = tuple(
        (
            ReportCell(str(k), k),
            ReportCell(fixed(event["t_s"], 1), event["t_s"]),
            ReportCell(clock(event["utc_s"])),
            ReportCell(event["kind"]),
            ReportCell(event["text"]),
        )
        for k, event in numbered[:MOST_ROWS]
    )
    columns = ("number", "time, s", "UTC", "kind", "text")
    found: list[Part] = [
        ReportTable(f"{id}-events", "Marks and events, numbered as on the map.", columns, rows)
    ]
    if len(numbered) > MOST_ROWS:
        left = len(numbered) - MOST_ROWS
        found.append(ReportText(f"{many(left, 'more event')} stand in the JSON file only."))
    return found


def _soil_changes(run: RunFacts, id: str) -> list[Part]:
    changes = [event for event in run["events"] if event["kind"] == SOIL_CHANGE]
    if not changes:
        return [ReportText("No change of soil was found.")]
    rows = tuple(
        (
            ReportCell(fixed(event["t_s"], 1), event["t_s"]),
            ReportCell(number(event["latitude_deg"], 8), event["latitude_deg"]),
            ReportCell(number(event["longitude_deg"], 8), event["longitude_deg"]),
            ReportCell(event["text"]),
        )
        for event in changes
    )
    columns = ("found at, s", "latitude, °", "longitude, °", "what")
    caption = "Changes of soil, and where the tractor was when they were found."
    return [ReportTable(f"{id}-soil", caption, columns, rows)]


def contradicted(run: RunFacts) -> list[tuple[str, float]]:
    """Keys of the machine file that the data contradict, and the share of poses in which they do."""
    flags = [(one["flag"].partition(":"), one["share"]) for one in run["flags"]]
    return [(key, share) for (kind, _, key), share in flags if kind == CONTRADICTION]


def at_a_glance(run: RunFacts) -> str:
    """One sentence for the beginning of the report."""
    driving = run["driving"]
    kinds = [NAMES[one["kind"]] for one in run["segments"]]
    counts = [f"{kinds.count(kind)} × {kind}" for kind in dict.fromkeys(kinds)]
    drove = f"{distance(driving['distance_m'])} in {seconds(run['duration_s'])}"
    return f"{run['id']}: {drove}" + (f"; found: {listed(counts)}" if counts else "; no segments found") + "."
