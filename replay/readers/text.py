"""Text logs with one frame a line, of candump, canboat and gateways.

Lines of all forms may be mixed; empty lines and comments (#) are passed over; anything else is counted.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from typing import Final, NamedTuple

from tilth.replay.readers import candump_text as candump
from tilth.replay.readers import gateway_text as gateway
from tilth.replay.readers.log import UNREADABLE, OpenLog, stamp_fault
from tilth.replay.readers.text_clock import TextClock
from tilth.schemas.flow import Frame

PEEKED: Final = 1000  # lines that tell how their stamps count
UNTIMED: Final = "its lines have no time stamps: all its frames are put at 0 s, and nothing can be estimated"


class Form(NamedTuple):
    name: str  # in a person's words; "" for what is no log of its own
    pattern: re.Pattern[str]
    take: Callable[[re.Match[str], TextClock], Frame | str]
    tells_length: bool = False  # so that a line without its end is known to be whole
    of_eight: bool = False  # so is one of 8 bytes


FORMS: Final = (
    Form("candump -l", candump.LOG, candump.log_line, of_eight=True),
    Form("candump", candump.TERMINAL, candump.terminal_line, tells_length=True),
    Form("candump of before 2008", candump.FORMER, candump.former_line, tells_length=True),
    Form("canboat's plain text", gateway.PLAIN, gateway.plain_line, tells_length=True),
    Form("a gateway's raw text", gateway.RAW, gateway.raw_line, of_eight=True),
    Form("Actisense's N2K ASCII", gateway.N2K_ASCII, gateway.n2k_ascii_line),
    Form("iKonvert", gateway.IKONVERT, gateway.ikonvert_line),
    Form("", gateway.IKONVERT_STATUS, gateway.ikonvert_status),
)


def form_of(line: str) -> str | None:
    """Which form a line has, in a person's words; None for none of them."""
    line = _bare(line)
    return next((form.name for form in FORMS if form.name and form.pattern.match(line)), None)


def frames(lines: Iterable[str], log: OpenLog) -> Iterator[Frame]:
    """Frames of the lines in their order; what is none is counted in log.skipped.

    A last line without its end is the cut unless it is known to be whole: it is left out and log.truncated
    says so.
    """
    lines = iter(lines)
    first = list(islice(lines, PEEKED))
    clock = TextClock(deltas=candump.are_deltas([_bare(line) for line in first]))
    form = FORMS[0]
    for line in chain(first, lines):
        head = line[:1]
        if head == "#" or line.isspace() or (head == "\t" and candump.EXPLAINED.match(line)):
            continue
        form, found = _read(_bare(line), form, clock)
        if not line.endswith("\n") and not _whole(form, found):
            log.truncated = True
        elif isinstance(found, str):
            log.skip(found)
        else:
            yield found
    if clock.untimed:
        log.note = UNTIMED


def _read(line: str, last: Form, clock: TextClock) -> tuple[Form, Frame | str]:
    """The form of a line, likely the last one's, and its frame or why it is none."""
    form, match = last, last.pattern.match(line)
    if match is None:
        form, match = next(((f, m) for f in FORMS if (m := f.pattern.match(line))), (last, None))
    if match is None:
        return last, UNREADABLE
    try:
        found = form.take(match, clock)
    except ValueError:  # an odd digit, a 13th month, a length that is not so
        return last, UNREADABLE
    fault = "" if isinstance(found, str) else stamp_fault(found.t_ns)
    return form, fault or found


def _whole(form: Form, found: Frame | str) -> bool:
    return isinstance(found, Frame) and (form.tells_length or (form.of_eight and len(found.data) == 8))


def _bare(line: str) -> str:
    return candump.COLOUR.sub("", line) if "\x1b" in line else line
