"""Draw which folder imports which: `python -m tilth.deploy.imports`, from a development install.

The sources are read, not run → docs/imports.svg: the folders, and the rooms of estimator/.
"""

import ast
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DRAWING = ROOT / "docs" / "imports.svg"
COMMAND = "uv run python -m tilth.deploy.imports"
STUDIES = "studies"  # not in the wheel, and not below `tilth`

Arrows = Mapping[str, frozenset[str]]
"""Box → the boxes that it imports from."""

HOLDS = {
    "schemas": "bytes, words, units",
    "estimator": "pure numerics",
    "logger": "the daemon",
    "replay": "logs, offline",
    "simulator": "virtual tractors",
    "analysis": "answers from logs",
    "client": "for controllers",
    "monitor": "the page",
    "adaptive_guidance": "an example",
    "cli": "the commands",
    "deploy": "installation",
    "studies": "not in the wheel",
    "compiled": "kernels",
    "kernel_digest": "what a kernel reads",
    "state_json": "stored state",
    "models": "how the rig moves",
    "rig": "its numbers",
    "pose": "both bodies, now",
    "record": "data on ticks",
    "filters": "likelihoods",
    "diagnosis": "is the file right",
    "calibration": "a rig by its driving",
    "results": "what is published",
    "methods": "the estimators",
    "fold": "frame in, results out",
}
WIDTH, GAP, HEIGHT = 128, 22, 44  # of a box, between boxes, px
FLATNESS = 0.36  # height of an arc over its half length, beyond ARC
ARC = 26
MARGIN = 24
INK, PALE = "#1b3a4b", "#9db4c0"
STYLE = (
    "text{font:12px sans-serif;fill:#1b1b1b}.b{font-weight:bold}.s{font-size:11px;fill:#555}"
    ".h{font-size:16px;font-weight:bold}"
)


def folders() -> dict[str, Path]:
    """Name below `tilth` → where its sources are, of everything that is packaged, and of the studies."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    places = {**project["tool"]["setuptools"]["package-dir"], STUDIES: STUDIES}
    return {name.removeprefix("tilth."): ROOT / place for name, place in places.items()}


def sources() -> dict[str, str]:
    """Module, as in `estimator.pose.body` → its source."""
    return {
        ".".join((folder, *path.relative_to(place).with_suffix("").parts)): path.read_text(encoding="utf-8")
        for folder, place in folders().items()
        for path in sorted(place.rglob("*.py"))
    }


@cache  # parsing all sources takes seconds, and each drawing and check asks anew
def imported(source: str) -> frozenset[str]:
    """What of tilth and of the studies a module imports anywhere in it, in a function too:
    `estimator.pose.body.centre`."""
    return frozenset(_imported(source))


def _imported(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (
            name.removeprefix("tilth.") for name in names if name.startswith(("tilth.", f"{STUDIES}."))
        )


def arrows(modules: Mapping[str, str], box: Callable[[str], str | None]) -> Arrows:
    """box: of a module or of something in it; None where it is not drawn."""
    found: dict[str, set[str]] = {}
    for module, source in modules.items():
        start = box(module)
        if start is None:
            continue
        ends = {box(name) for name in imported(source)}
        found.setdefault(start, set()).update(end for end in ends if end not in (None, start))
    return {start: frozenset(ends) for start, ends in found.items()}


def between_folders(modules: Mapping[str, str]) -> Arrows:
    return arrows(modules, lambda name: name.partition(".")[0])


def between_rooms(modules: Mapping[str, str]) -> Arrows:
    """Of estimator/. Modules of the folder itself that a room imports, and what these import, are boxes of
    their own. The others, among them the fold, are one."""
    inside = {
        name: source
        for name, source in modules.items()
        if name.startswith("estimator.") and not name.endswith("__init__")
    }
    rooms = {name.split(".")[1] for name in inside if name.count(".") > 1}
    under: set[str] = set()
    while True:
        more = {
            used.split(".")[1]
            for name, source in inside.items()
            if name.split(".")[1] in rooms | under
            for used in imported(source)
            if used.startswith("estimator.")
        } - rooms
        if more <= under:
            break
        under |= more

    def box(name: str) -> str | None:
        parts = name.split(".")
        if parts[0] != "estimator" or len(parts) < 2:
            return None
        return parts[1] if parts[1] in rooms | under else "fold"

    return arrows(inside, box)


def circle(found: Arrows) -> list[str]:
    """Boxes that import one another in a circle, the first again at the end; [] where there is none."""
    try:
        TopologicalSorter(found).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def in_order(found: Arrows) -> list[str]:
    """Each box after all from which it imports, and otherwise as near to these as can be."""
    boxes = set(found).union(*found.values())
    order: list[str] = []
    while boxes - set(order):
        free = [box for box in boxes - set(order) if found.get(box, frozenset()) <= set(order)]
        # The one whose furthest import is nearest to the end: short arcs, and layers stay together.
        order.append(min(free, key=lambda box: (_depth(found, box), len(found.get(box, ())), box)))
    return order


def _depth(found: Arrows, box: str) -> int:
    return 1 + max((_depth(found, end) for end in found.get(box, ())), default=-1)


def follows(found: Arrows, start: str, end: str) -> bool:
    """Whether the end is reached from the start by way of others too."""
    return any(_reaches(found, other, end) for other in found[start] if other != end)


def _reaches(found: Arrows, start: str, end: str) -> bool:
    return start == end or any(_reaches(found, other, end) for other in found.get(start, ()))


def _panel(found: Arrows, title: str, top: int) -> tuple[list[str], int, int]:
    """SVG lines, width, and where the panel ends."""
    order = in_order(found)
    place = {box: MARGIN + i * (WIDTH + GAP) for i, box in enumerate(order)}
    incoming = {box: [start for start in order if box in found.get(start, ())] for box in order}
    longest = max(order.index(s) - order.index(e) for s, ends in found.items() for e in ends)
    line = top + 40 + ARC + round(longest * (WIDTH + GAP) / 2 * FLATNESS)
    out = [f'<text class="h" x="{MARGIN}" y="{top + 18}">{escape(title)}</text>']
    drawn: list[tuple[bool, str]] = []
    for start, ends in found.items():
        # A near box is left further to the left than a far one, and reached further to the right: arcs that
        # share a box do not cross there.
        leaving = sorted(ends, key=lambda end: -place[end])
        for end in ends:
            coming = sorted(incoming[end], key=place.__getitem__)
            left = place[end] + WIDTH - 8 - _port(coming.index(start), len(coming))
            right = place[start] + 8 + _port(leaving.index(end), len(leaving))
            rise = ARC + (right - left) / 2 * FLATNESS
            pale = follows(found, start, end)
            drawn.append((not pale, _arc(left, right, line, rise, pale, f"{start} imports {end}")))
    out += [arc for _, arc in sorted(drawn)]
    for box in order:
        middle = place[box] + WIDTH / 2
        out += [
            f'<rect x="{place[box]}" y="{line}" width="{WIDTH}" height="{HEIGHT}" rx="5" fill="#f3f6ee" '
            'stroke="#6b7f4a"/>',
            f'<text class="b" x="{middle:g}" y="{line + 18}" text-anchor="middle">{_label(box)}</text>',
            f'<text class="s" x="{middle:g}" y="{line + 34}" text-anchor="middle">{_held(box)}</text>',
        ]
    return out, MARGIN * 2 + len(order) * (WIDTH + GAP) - GAP, line + HEIGHT


def _label(box: str) -> str:
    return escape({"fold": "the fold"}.get(box, box))


def _held(box: str) -> str:
    return escape(HOLDS.get(box, ""))


def _port(index: int, count: int) -> float:
    return index * min(9.0, (WIDTH / 2 - 12) / max(count - 1, 1))


def _arc(left: float, right: float, line: int, rise: float, pale: bool, title: str) -> str:
    colour, width, head = (PALE, 1, "pale") if pale else (INK, 1.8, "ink")
    top = f"{line - rise * 4 / 3:.1f}"  # of the control points; the arc goes up by `rise`
    path = f"M{right:.1f} {line}C{right:.1f} {top} {left:.1f} {top} {left:.1f} {line - 2}"
    return (
        f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width}" marker-end="url(#{head})">'
        f"<title>{escape(title)}</title></path>"
    )


def _heads() -> Iterable[str]:
    for name, colour in (("ink", INK), ("pale", PALE)):
        yield (
            f'<marker id="{name}" markerUnits="userSpaceOnUse" markerWidth="9" markerHeight="9" refX="8" '
            f'refY="4.5" orient="auto"><path d="M0 1L8 4.5L0 8z" fill="{colour}"/></marker>'
        )


def drawing(modules: Mapping[str, str]) -> str:
    """The drawing as SVG. Raises ValueError where there is a circle: it has no order from left to right."""
    out: list[str] = []
    top, widest = MARGIN, 0
    for title, found in (
        ("The folders: imports go left only. There is no circle.", between_folders(modules)),
        ("The rooms of estimator/: imports go left only. There is no circle.", between_rooms(modules)),
    ):
        if circle(found):
            raise ValueError(f"imports in a circle: {' → '.join(circle(found))}")
        panel, width, end = _panel(found, title, top)
        out += panel
        top, widest = end + 36, max(widest, width)
    note = "Pale: an import that also follows from the dark ones, by way of other boxes. Written by"
    out.append(f'<text class="s" x="{MARGIN}" y="{top}">{note} {COMMAND}</text>')
    height = top + MARGIN
    size = f'viewBox="0 0 {widest} {height}" width="{widest}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
    ground = '<rect width="100%" height="100%" fill="white"/>'
    defs = f"<style>{STYLE}</style><defs>{''.join(_heads())}</defs>"
    return "\n".join([head, ground, defs, *out, "</svg>"]) + "\n"


def main() -> None:
    DRAWING.write_text(drawing(sources()), encoding="utf-8")


if __name__ == "__main__":
    main()
