"""Writes a report: all of its files or none, and none under its final name before it is whole."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

from tilth.analysis.report.document import DriveReport, figures_of
from tilth.analysis.report.figures import pdf, svg
from tilth.analysis.report.page import page
from tilth.analysis.report.paper import paper
from tilth.schemas.readable import readable


def outputs(out: Path, with_pdf: bool) -> list[Path]:
    """The files of a report, but for single figures."""
    return [out, out.with_suffix(".json"), *([out.with_suffix(".pdf")] if with_pdf else [])]


def json_text(content: dict[str, object]) -> str:
    """As it stands in the file; halves of characters, as in names that are not UTF-8, escaped."""
    text = json.dumps(content, allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    return text.encode(errors="backslashreplace").decode()


def write(
    report: DriveReport,
    content: dict[str, object],
    out: Path,
    *,
    with_pdf: bool = False,
    figures: Path | None = None,
) -> list[Path]:
    """The files written. content: the JSON object of the report. figures: a folder for each figure alone; it
    is made where there is none. Raises FileExistsError, OSError, NoTypst; then there are no new files."""
    made = figures is not None and not figures.exists()
    if figures is not None:
        figures.mkdir(exist_ok=True)
    parts: list[tuple[Path, Path]] = []
    try:
        for path, data in _contents(report, content, out, with_pdf, figures):
            part = path.with_name(f".{path.name}.{os.getpid()}.part")
            parts.append((part, path))
            part.write_bytes(data)
        for _, path in parts:
            if path.exists():
                raise FileExistsError(17, "exists", str(path))
        for part, path in parts:
            part.rename(path)
    except BaseException:
        for part, _ in parts:
            part.unlink(missing_ok=True)
        if made and figures is not None:
            figures.rmdir()
        raise
    return [path for _, path in parts]


def _contents(
    report: DriveReport, content: dict[str, object], out: Path, with_pdf: bool, figures: Path | None
) -> Iterator[tuple[Path, bytes]]:
    yield out, readable(page(report)).encode()
    yield out.with_suffix(".json"), readable(json_text(content)).encode()
    if with_pdf:
        yield out.with_suffix(".pdf"), paper(report)
    if figures is not None:
        for figure in figures_of(report):
            yield figures / f"{figure.id}.svg", svg(figure).encode()
            yield figures / f"{figure.id}.pdf", pdf(figure)
