"""What chapter 7 of the dissertation prints twice or against its own equations."""

from collections.abc import Sequence

from studies.dissertation.compared import number
from studies.dissertation.errata import Erratum
from studies.dissertation.field_tables import ESTIMATES, FIRST, N2_ERRORS, merged, named

C_AI, SIGMA_I = 2, 5  # columns of the tables
MERGED = ((1, 2), (1, 3), (2, 3), (1, 2, 3))


def field_errata() -> list[Erratum]:
    """Rows of chapter 7, in the order of its tables."""
    off = [runs for runs in MERGED if not agrees(runs, C_AI)]
    spread = [number(ESTIMATES[(k,)][0][SIGMA_I], 1) for k in (1, 2, 3)]
    return [
        Erratum("Table 7.3, N2: σ_i", number(FIRST[SIGMA_I], 1), number(ESTIMATES[(2,)][0][SIGMA_I], 1),
                f"Table 7.5 has {spread[1]} m for N2, {spread[0]} for N1; its merged ones follow from them"),
        Erratum("7.3, text", "C_αi 80 in the second field, C_αf 101 and C_αr 542 in the first",
                "100; 100 and 540 in Table 7.3",
                "the last two are the same unrounded; the first is open"),
        Erratum("Table 7.4, last column", "N2", "N3", "the column before it is N2's, as its 0.2 m shows"),
        Erratum("Table 7.4, N2 over N1 and N3", _row_of_n2(), "–",
                "the text has 5.68 / 5.91 and 3.31 / 4.18 m; nothing in print decides"),
        Erratum("Table 7.5, C_αi of " + ", ".join(map(named, off)), _values(off), _by_equation(off),
                "7.20 with the three single runs; every merged σ agrees with it"),
    ]  # fmt: skip


def agrees(runs: tuple[int, ...], column: int) -> bool:
    """Whether a printed merged value follows from 7.20 within what rounding leaves: half a unit of the last
    place of its parts, and half a one of its own."""
    step = 5.0 + 0.5 if column == C_AI else 0.05 + 0.05
    return abs(ESTIMATES[runs][0][column] - merged(runs)[0][column]) <= step


def _row_of_n2() -> str:
    (one, _, three) = (" / ".join(number(value, 1) for value in pair) for pair in N2_ERRORS)
    return f"{one} and {three} m"


def _values(rows: Sequence[tuple[int, ...]]) -> str:
    return ", ".join(number(ESTIMATES[runs][0][C_AI], 0) for runs in rows)


def _by_equation(rows: Sequence[tuple[int, ...]]) -> str:
    return ", ".join(number(merged(runs)[0][C_AI], 0) for runs in rows)
