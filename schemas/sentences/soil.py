"""Words of the soil: soft, firm or as usual, by what the tyres' stiffness is of the machine file's."""

import math
from enum import StrEnum
from typing import Final

from tilth.schemas.flow import Status

SOFT: Final = 0.9  # of the machine file's stiffness: soft where all of the 95 % is below
FIRM: Final = 1.1  # firm where all of it is above
USUAL: Final = (2 / 3, 3 / 2)  # as usual where none of both, and all of it is in here


class SoilWord(StrEnum):
    """How the soil holds a group of tyres, as the page shows it."""

    SOFT = "soft"
    USUAL = "as usual"
    FIRM = "firm"
    SOFT_TO_USUAL = "between soft and usual"
    USUAL_TO_FIRM = "between usual and firm"
    ROUGH = "known roughly"  # its 95 % reach from soft to firm
    NOT_KNOWN_YET = "not known yet"
    NOT_KNOWN_NOW = "not known now"  # it was, but has grown old
    WITHDRAWN = "withdrawn"  # something contradicts


def soil_words(value: float | None, within: float | None, status: int, usual: float | None) -> dict[str, str]:
    """How the soil holds a group of tyres, against the machine file's: a word, and what it rests on."""
    if status == Status.INVALID:
        return {"word": SoilWord.WITHDRAWN, "text": ""}
    if status == Status.STALE:
        return {"word": SoilWord.NOT_KNOWN_NOW, "text": ""}
    if status != Status.ESTIMATED or value is None or within is None or not usual:
        return {"word": SoilWord.NOT_KNOWN_YET, "text": ""}
    ratio = value / usual
    low, high = ratio * math.exp(-within), ratio * math.exp(within)
    text = f"{_percent(ratio)} % of usual (95 %: {_percent(low)} to {_percent(high)} %)"
    if high < SOFT:
        return {"word": SoilWord.SOFT, "text": text}
    if low > FIRM:
        return {"word": SoilWord.FIRM, "text": text}
    between = {(True, True): SoilWord.USUAL, (True, False): SoilWord.USUAL_TO_FIRM,
               (False, True): SoilWord.SOFT_TO_USUAL, (False, False): SoilWord.ROUGH}  # fmt: skip
    return {"word": between[USUAL[0] <= low, high <= USUAL[1]], "text": text}


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.0f}"
