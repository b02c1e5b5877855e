"""Dates as programs write them for people, in the language of the computer they ran on.

    Mon Oct 5 03:06:13.191 pm 2026       English
    Mit Okt 5 03:06:13.191 nachm 2026    German
    lun. oct. 5 15:06:13.191 2026        French; Italian, Spanish, Portuguese and Dutch are alike
    06.03.2009 16:15:12.317.3            day, month, year

Words are compared by their plain letters alone: what an accent has become in a text of another encoding does
not matter.
"""

import re
from datetime import UTC, datetime
from typing import Final

from tilth.replay.readers.text_clock import SECOND, nanoseconds

_MONTHS: Final = (
    "january januar jänner janvier gennaio enero janeiro",
    "february februar février fevrier febbraio febrero fevereiro",
    "march märz maerz mars marzo março marco maart mrt",
    "april avril aprile abril",
    "may mai maggio mayo maio mei",
    "june juni juin giugno junio junho",
    "july juli juillet luglio julio julho",
    "august août aout agosto augustus",
    "september septembre settembre septiembre setembro",
    "october oktober octobre ottobre octubre outubro",
    "november novembre noviembre",
    "december dezember décembre decembre dicembre diciembre dezembro",
)
_MORNING: Final = {"am", "vorm", "vormittag", "matin", "上午", "午前", "오전"}
_AFTERNOON: Final = {"pm", "nachm", "nachmittag", "下午", "午後", "오후"}
_CLOCK: Final = re.compile(r"(\d{1,2}):(\d\d?):(\d\d?)(?:[.,:](\d{1,9}))?(?:\.\d)?([^\W\d]*)\.?$")
_NUMBERS: Final = re.compile(r"(\d{1,4})[./:-](\d{1,2})[./:-](\d{1,4})$")
_DAY: Final = re.compile(r"(\d{1,2})(?:er|\.|º|°)?$")


def _letters(word: str) -> str:
    return re.sub("[^a-z]", "", word.lower())


def _beginnings() -> dict[str, int]:
    """{beginning of a month's name, in letters: month}; without what begins two of them."""
    found: dict[str, set[int]] = {}
    for number, names in enumerate(_MONTHS, 1):
        for name in names.split():
            bare = _letters(name)
            shortest = 3 if bare == name else 2  # with its accents it had one more
            for end in range(shortest, len(bare) + 1):
                found.setdefault(bare[:end], set()).add(number)
    return {beginning: months.pop() for beginning, months in found.items() if len(months) == 1}


_MONTH: Final = _beginnings()


def utc_ns(text: str) -> int:
    """Nanoseconds since 1970 of a date and time of day, read as UTC. Raises ValueError.

    Of numbers alone the day is before the month, but for 2026-10-05 and where there is no such month.
    """
    words = [word.strip(",") for word in text.split()]
    clocks = [match for match in map(_CLOCK.match, words) if match]
    if len(clocks) != 1:
        raise ValueError("no time of day")
    h, m, s, fraction, half = clocks[0].groups()
    marks = {half.lower(), _halves(words), *(word for word in words if not word.isascii())}
    hour = int(h)
    if marks & _AFTERNOON and hour < 12:
        hour += 12
    elif marks & _MORNING and hour == 12:
        hour = 0
    year, month, day = _date([word for word in words if not _CLOCK.match(word)])
    at = datetime(year, month, day, hour, int(m), int(s), tzinfo=UTC)
    return int(at.timestamp()) * SECOND + nanoseconds(fraction)


def _halves(words: list[str]) -> str:
    """am, pm, vorm, nachm: of one word, or of two as in "p. m."."""
    letters = [_letters(word) for word in words]
    joined = "".join(word for word in letters if word in ("a", "p", "m"))
    return next((word for word in letters if word in _MORNING | _AFTERNOON), joined)


def _date(words: list[str]) -> tuple[int, int, int]:
    """(year, month, day)"""
    for numbers in filter(None, map(_NUMBERS.match, words)):
        first, second, third = map(int, numbers.groups())
        if len(numbers[1]) == 4:
            return first, second, third
        return (third, first, second) if second > 12 else (third, second, first)
    months = [month for month in (_MONTH.get(_letters(word)) for word in words) if month]
    years = [int(word) for word in words if re.fullmatch(r"\d{4}", word)]
    days = [int(match[1]) for match in map(_DAY.match, words) if match]
    if not months or len(years) != 1 or len(days) != 1:
        raise ValueError("no date")
    return years[0], months[-1], days[0]  # a weekday that begins as a month does is before it
