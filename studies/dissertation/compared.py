"""What a page is made of: a figure in print beside ours, and tables in Markdown."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

SLACK = 1e-9  # of a comparison, so that a tie in print is no difference


class ComparedFigure(NamedTuple):
    """One figure of the dissertation. `why` says what is behind a difference, or what agreement hangs on."""

    where: str  # section, figure or equation
    what: str
    printed: str
    ours: str
    agrees: bool
    why: str = ""
    within: str = ""  # where the print says "about": what was allowed


def figures(
    where: str,
    what: str,
    printed: Sequence[float],
    ours: Sequence[float],
    *,
    digits: int,
    within: float | None = None,
    why: str = "",
) -> ComparedFigure:
    """A line of numbers, the printed ones with so many decimals.

    They agree within half a unit of the last printed place, or `within` where the print says "about".
    """
    room = 0.5 * 10.0**-digits if within is None else within
    agrees = all(abs(p - o) <= room + SLACK for p, o in zip(printed, ours, strict=True))
    about = "" if within is None else "about "
    return ComparedFigure(
        where,
        what,
        about + ", ".join(number(value, digits) for value in printed),
        ", ".join(number(value, digits + (2 if digits else 1)) for value in ours),
        agrees,
        why,
        "" if within is None else f" within {within:g}",
    )


def claim(where: str, what: str, printed: str, ours: str, holds: bool, why: str = "") -> ComparedFigure:
    """A line that is no list of numbers."""
    return ComparedFigure(where, what, printed, ours, holds, why)


def number(value: float, digits: int) -> str:
    """With a true minus sign, and none before zero."""
    text = f"{value:.{digits}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def pole(value: complex, digits: int = 2) -> str:
    """A real eigenvalue, or a pair as −1.00 ± 2.00j."""
    real = number(value.real, digits)
    return real if value.imag == 0 else f"{real} ± {number(abs(value.imag), digits)}j"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, its first column to the left, the others to the right."""
    rule = ["---", *["---:"] * (len(headings) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (headings, rule, *rows))


def compared(lines: Iterable[ComparedFigure]) -> str:
    """The lines as a table in Markdown."""
    head = ("where", "figure", "printed", "ours", "verdict")
    rows = [
        (line.where, line.what, line.printed, line.ours, verdict(line)) for line in lines
    ]  # fmt: skip
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ("---",) * len(head), *rows))


def verdict(line: ComparedFigure) -> str:
    """In words. A difference has a reason: raises ValueError where it has none."""
    if not line.agrees and not line.why:
        raise ValueError(
            f"{line.where}, {line.what}: {line.printed} is not {line.ours}, and nothing says why"
        )
    return (f"agrees{line.within}" if line.agrees else "**differs**") + (f": {line.why}" if line.why else "")
