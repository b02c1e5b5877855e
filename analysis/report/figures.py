"""Figures of a report to SVG and PDF, the same bytes from the same numbers.

For a page an SVG stands inside the HTML: its text is text, its ink is the page's, for the dark as well.
"""

import re
from collections.abc import Callable, Mapping
from html import escape
from io import BytesIO, StringIO
from typing import Any, Final

import matplotlib
from matplotlib.figure import Figure

from tilth.analysis.report import drive_figures, result_figures
from tilth.analysis.report.document import ReportFigure
from tilth.analysis.report.figure_look import GRID, INK, LOOK, PAPER, QUIET
from tilth.analysis.report.season_figures import SEASON_DRAWINGS
from tilth.analysis.report.sensitivity_figures import SENSITIVITY_DRAWINGS
from tilth.schemas.readable import readable

DRAWINGS: Final[Mapping[str, Callable[[Mapping[str, Any]], Figure]]] = {
    "path": drive_figures.path,
    "drive": drive_figures.drive,
    "parameters": drive_figures.parameters,
    "correlation": result_figures.correlation,
    "nuisances": result_figures.nuisances,
    "intervals": result_figures.intervals,
    "response": result_figures.response,
}
"""Of a drive, by the kind of a figure."""
ALL_DRAWINGS: Final = {**DRAWINGS, **SENSITIVITY_DRAWINGS, **SEASON_DRAWINGS}
ZOOMING: Final = frozenset({"field_map"})
"""Kinds of which the panels zoom on a page, all together."""
PAGE_COLOURS: Final = {INK: "var(--ink)", GRID: "var(--grid)", QUIET: "var(--quiet)", PAPER: "var(--paper)"}
PT_PER_REM: Final = 8.5  # of a figure at its widest: its letters are then about as large as the page's
_ID = re.compile(r' id="([^"]+)"')
ZOOMED = re.compile(r"panel-\d+|scale$")  # what the script of a page looks for: gids of season_figures
_USED = re.compile(r'(?:url\(#|href="#)([^)"]+)')


def svg(figure: ReportFigure, *, text: bool = False) -> str:
    """A whole SVG file. text: text as text, in the reader's font; else as outlines, the same everywhere."""
    with matplotlib.rc_context({**LOOK, "svg.fonttype": "none" if text else "path"}):
        stream = StringIO()
        ALL_DRAWINGS[figure.kind](figure.data).savefig(
            stream, format="svg", metadata={"Date": None, "Title": figure.id}
        )
    return stream.getvalue()


def pdf(figure: ReportFigure) -> bytes:
    """A PDF of the figure alone, with its fonts."""
    with matplotlib.rc_context(LOOK):
        stream = BytesIO()
        dates = {"CreationDate": None, "ModDate": None, "Title": figure.id}
        ALL_DRAWINGS[figure.kind](figure.data).savefig(stream, format="pdf", metadata=dates)
    return stream.getvalue()


def inline(figure: ReportFigure) -> str:
    """An <svg> element for a page, named and described for who cannot see it."""
    whole = svg(figure, text=True)
    body = whole[whole.index(">", whole.index("<svg")) + 1 : whole.rindex("</svg>")]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.S)
    body = re.sub(r"<style[^>]*>.*?</style>", "", body, flags=re.S)  # would hold for the whole page
    body = re.sub(r"<!--.*?-->", "", body, flags=re.S)
    used = set(_USED.findall(body))
    body = _ID.sub(
        lambda found: f' id="{figure.id}-{found[1]}"' if found[1] in used or ZOOMED.match(found[1]) else "",
        body,
    )
    body = re.sub(r"url\(#", f"url(#{figure.id}-", body)
    body = re.sub(r'(?:xlink:)?href="#', f'href="#{figure.id}-', body)
    body = re.sub(r"'DejaVu Sans'[^;\"]*", "sans-serif", body)
    for colour, variable in PAGE_COLOURS.items():
        body = body.replace(colour, variable)
    body = re.sub(r"\s*\n\s*", "\n", body)
    box = re.search(r'viewBox="([^"]+)"', whole)
    assert box is not None
    width = float(box[1].split()[2])
    name, told = f"{figure.id}-title", f"{figure.id}-desc"
    names = f'<title id="{name}">{escape(readable(figure.caption))}</title>'
    return (
        f'<svg role="img" viewBox="{box[1]}" style="max-width: {width / PT_PER_REM:.1f}rem" '
        f'aria-labelledby="{name}" aria-describedby="{told}">{names}'
        f'<desc id="{told}">{escape(readable(figure.description))}</desc>{body}</svg>'
    )
