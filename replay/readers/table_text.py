"""Text logs whose header says what their columns hold.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8                    SavvyCAN, GVRET: µs
    166200000,09F8011C,true,Rx,0,8,40,DD,4A,1F,80,F9,37,03,
    TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes   CANedge
    1700000000.200000;1;9F8011C;1;8;8;0;0;0;0;0;40DD4A1F80F93703
    Timestamp;Type;ID;Data                                                        CL1000, CL2000, CL3000
    01T022231683;1;09f8011c;40dd4a1f80f93703
    timestamp,arbitration_id,extended,remote,error,dlc,data                       python-can: base64
            Time Chan   Identifier Flags        DLC  Data            Counter      Kvaser Memorator
        0.200000  1    9F8011Cx   Rx              8  40 DD 4A 1F 80 F9 37 03  1
    ***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***                    BUSMASTER
    11:49:12:9420 Rx 1 0x09F8011C x 8 40 DD 4A 1F 80 F9 37 03

Columns are known by their names (columns.py), in any order, between commas, semicolons, tabs, bars or blanks.
Where nothing says whether numbers are hexadecimal, the first lines do.
"""

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from tilth.replay.readers.columns import LAST_ID, Role, bus_of, frame_of, is_so, plain, role_of, unit_ns
from tilth.replay.readers.log import OpenLog
from tilth.replay.readers.text_clock import SECOND, ZONE, TextClock, nanoseconds, time_ns
from tilth.replay.readers.written_dates import utc_ns
from tilth.schemas.flow import Frame

_SEPARATORS: Final = (";", "\t", ",", "|")
_NUMBER: Final = re.compile(r"(?P<sign>-?)(?P<whole>\d{1,19})(?:[.,](?P<part>\d{1,18}))?$")
_POWER: Final = re.compile(r"-?\d(?:\.\d{1,17})?e[+-]?\d\d$", re.IGNORECASE)  # as repr() gives some seconds
_ISO: Final = re.compile(
    r"(?P<date>\d{4}[-/.]?\d\d[-/.]?\d\d)[-T Z_]+(?P<h>[01]\d|2[0-3]):?(?P<m>[0-5]\d):?(?P<s>[0-5]\d|60)"
    rf"[.,:]?(?P<fraction>\d{{1,9}})?{ZONE}$"
)
_DAY: Final = re.compile(
    r"(?P<day>[0-3]\d)T(?P<h>[01]\d|2[0-3]):?(?P<m>[0-5]\d):?(?P<s>[0-5]\d)[.,:]?(?P<fraction>\d{1,9})?$"
)
_CLOCK: Final = re.compile(
    r"(?P<h>\d{1,3}):(?P<m>[0-5]?\d):(?P<s>[0-5]?\d|60)(?:[.,:](?P<fraction>\d{1,9}))?$"
)
_TIME: Final = ("h", "m", "s", "fraction")
_BASE_64: Final = "timestamp,arbitration_id,extended,remote,error,dlc,data"
_EVENT: Final = re.compile(r"\s*-?\d+[.,]\d+\s+Trigger\b")
_BASE: Final = re.compile(r"\s*Format of (data|id) field:\s*(HEX|DEC)|\*\*\*(HEX|DEC)\*\*\*", re.IGNORECASE)
_CREATED: Final = re.compile(r"\s*(?:Memorator Binary logfile created at|DateTime):\s*(\S.*)")
_STARTED: Final = re.compile(r"\*\*\*START DATE AND TIME ([^*]*\d)[^*]*\*\*\*")
_MODE: Final = re.compile(r"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE\*\*\*")
_CL_STARTED: Final = re.compile(r"#\s*Time:\s*(\d{8})T\d{6}")
_COMMENTS: Final = ("#", "//", "===", "***")
_HEX: Final = re.compile("[0-9A-Fa-f]+")


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """Where a header puts what; `data` are the columns of the data, if several one for each byte."""

    separator: str | None  # None: blanks
    places: dict[Role, int]
    data: tuple[int, ...]
    unit_ns: int = 0  # of the times; 0: not said
    whole_ns: int = 0  # of times that are whole numbers; 0: their size tells
    base_64: bool = False
    spills: bool = False  # the data are in its last column: further bytes may be in further cells

    @property
    def end(self) -> int:
        """The last column that a frame needs."""
        return max(*self.places.values(), self.data[-1])


KVASER: Final = ColumnLayout(None, {"time": 0, "bus": 1, "id": 2, "flags": 3, "dlc": 4}, (5,), SECOND)
KVASER_ROW: Final = re.compile(
    r"\s*-?\d+\.\d+ +\d+ +(?:ErrorFrame\b|[0-9A-Fa-f]+(?: *x)? +(?:[RT]x(?:Rq)? +)?(?:[EFBPRW#]+ +)*"
    r"\d+ +(?:RTR|(?:[0-9A-Fa-f]{2,3} +){0,64}) *\d+\s*$)"
)


def layout_of(line: str) -> ColumnLayout | None:
    """The layout that a header gives; None of what is no header of a table of frames."""
    bare = line.strip().lstrip("\ufeff")
    separator = next((mark for mark in _SEPARATORS if mark in bare), None)
    if bare.startswith("***<"):
        names = re.findall("<([^>]*)>", bare)
        separator = None
    else:
        names = [name.strip().strip('"') for name in bare.split(separator)]
    roles: list[Role | None] = [role_of(name) for name in names]
    places: dict[Role, int] = {}
    for at, role in enumerate(roles):
        if role is not None and role != "byte":
            places.setdefault(role, at)
    bytes_at = [at for at, role in enumerate(roles) if role == "byte"]
    data = [places.pop("data")] if "data" in places else bytes_at
    if "id" not in places or not data or not places.keys() & {"time", "dlc", "length"}:
        return None
    if separator is None and not ("time" in places and places.keys() & {"dlc", "length"}):
        return None  # prose
    unit = unit_ns(names[places["time"]]) if "time" in places else 0
    gvret = "time" in places and plain(names[places["time"]]) == "timestamp" and len(data) > 1
    last = data[-1] == len(names) - 1 and len(data) == 1
    return ColumnLayout(
        separator, places, tuple(data), unit, 1_000 if gvret else 0, bare.lower() == _BASE_64, last
    )


@dataclass(slots=True)
class TextTable:
    """Reads lines of a table, one after the other."""

    log: OpenLog
    layout: ColumnLayout | None = None
    clock: TextClock = field(default_factory=TextClock)
    id_base: int = 0  # 0: not known yet
    data_base: int = 0
    origin_ns: int = 0  # of times that count from a start
    date: str = ""  # of the file's head: what times without a date belong to
    mode: str = ""  # BUSMASTER's: what its times count from
    begun: bool = False  # a row has been read
    untold_ns: int | None = None  # a calendar date that belongs to the next row

    def peek(self, lines: Sequence[str]) -> None:
        """Find out from the first lines in which base numbers are."""
        layout = self.layout
        identifiers: list[str] = []
        octets: list[str] = []
        for line in lines:
            if not line.endswith("\n"):
                continue  # it may be cut
            if (found := layout_of(line)) is not None:
                layout = found
            elif layout is not None and not _is_comment(line):
                try:
                    row = _split(line, layout)
                except (LookupError, ValueError):
                    continue  # of the head
                identifiers.append(row.get("id", ""))
                octets += row.get("data", "").split()
        self.id_base = 10 if _is_decimal(identifiers, LAST_ID) else 16
        short = self.id_base == 10 and all(map(str.isdecimal, octets)) and 1 in map(len, octets)
        self.data_base = 10 if short or (_is_decimal(octets, 255) and max(map(len, octets)) < 4) else 16

    def take(self, line: str) -> Frame | str | None:
        """The frame of a line, or why it has none; None of what is no row. Raises ValueError."""
        if not line.strip():
            return None
        if _is_comment(line) or (not self.begun and _BASE.match(line)) or _CREATED.match(line):
            self._remember(line)
            return None
        if _EVENT.match(line):
            return "other_event"
        try:
            found = self._row(line) if self.layout is not None else None
        except (ValueError, LookupError):
            found = None
        if found is not None:
            self.begun = True
            return found
        if (layout := layout_of(line)) is not None:
            self.layout = layout
            return None
        if self.begun or (self.layout is not None and self.layout is not KVASER):
            raise ValueError("no row")
        return None  # before the table begins

    def whole(self, line: str) -> bool:
        """Whether a line that gave a frame is known to be whole without its end."""
        layout = self.layout
        if layout is None or layout.end > layout.data[-1]:
            return False
        row = _split(line, layout)
        told = row.get("length") or row.get("dlc")
        if not told:
            return False
        if layout.base_64:
            return True  # its length was right
        if layout.separator is None:
            return self.data_base == 16 and len(line.split()[-1]) == 2
        cells = _cells(line, layout)
        last = layout.data[max(0, min(int(told), len(layout.data)) - 1)] if int(told) else layout.data[0] - 1
        if len(cells) > last + 1 and not (layout.spills and int(told)):
            return True  # something follows
        return self.data_base == 16 and sum(map(len, _tokens(row["data"]))) == 2 * int(told) > 0

    def _remember(self, line: str) -> None:
        """What a head says beside its columns."""
        if (match := _BASE.match(line)) is not None:
            base = 10 if (match[2] or match[3]).upper() == "DEC" else 16
            what = (match[1] or "").lower()
            self.id_base = base if what != "data" else self.id_base
            self.data_base = base if what != "id" else self.data_base
        elif (match := _CREATED.match(line)) is not None:
            calendar = line.lstrip().startswith("DateTime")
            if not calendar or not self.begun:  # later dates are of whole seconds: worse than the count
                self.untold_ns = self._dated(match[1])
                self.origin_ns = 0 if calendar else self.untold_ns or 0
                self.untold_ns = self.untold_ns if calendar else None
        elif (match := _STARTED.match(line)) is not None:
            self.origin_ns = self._dated(match[1]) or 0
            self.clock.on(_iso(self.origin_ns), self.origin_ns % (86_400 * SECOND))
        elif (match := _MODE.match(line)) is not None:
            self.mode = match[1]
        elif (match := _CL_STARTED.match(line)) is not None:
            self.date = match[1]

    def _dated(self, text: str) -> int | None:
        try:
            found = utc_ns(text)
        except ValueError:
            self.log.remark(f'its date "{text.strip()}" cannot be read')
            return None
        self.clock.zoneless = True
        return found

    def _row(self, line: str) -> Frame | str:
        assert self.layout is not None
        row = _split(line, self.layout)
        if row.get("error", "").lower() == "errorframe":
            row["id"], row["data"] = "0", ""
        t_ns = self._stamp(row["time"]) if "time" in row else self.clock.nothing()
        identifier = row["id"].lower()
        suffixed = identifier.endswith("x")
        number = _number(identifier.removesuffix("x"), self.id_base)
        extended, remote, error = _flags(row)
        wide = "extended" not in row and len(identifier.removeprefix("0x").removesuffix("x")) == 8
        return frame_of(
            (t_ns, t_ns),
            bus_of(row.get("bus", "")),
            number,
            base64.b64decode(row["data"], validate=True) if self.layout.base_64 else self._data(row["data"]),
            extended=suffixed or extended or (wide and not row.keys() & {"flags", "type"}),
            remote=remote,
            error=error,
            dlc=int(row["dlc"]) if row.get("dlc") else None,
            length=int(row["length"]) if row.get("length") else None,
        )

    def _data(self, text: str) -> bytes:
        if self.data_base == 10:
            return bytes(map(int, text.split()))
        return bytes.fromhex("".join(f"0{token}" if len(token) == 1 else token for token in _tokens(text)))

    def _stamp(self, text: str) -> int:
        """Of a cell that holds a time."""
        assert self.layout is not None
        if (match := _NUMBER.match(text)) is not None:
            value_ns = self._counted_ns(match, self.layout)
        elif _POWER.match(text):
            value_ns = round(float(text) * 1e6) * 1000
        else:
            return self._calendar(text)
        if self.untold_ns is not None:
            self.origin_ns, self.untold_ns = self.untold_ns - value_ns, None
        return self.origin_ns + value_ns

    def _counted_ns(self, match: re.Match[str], layout: ColumnLayout) -> int:
        whole, part = int(match["whole"]), match["part"]
        unit = layout.unit_ns
        if not unit and part is not None:
            unit = SECOND
        if not unit:
            unit = layout.whole_ns if layout.whole_ns and whole < 10**17 else _unit_by_size(whole)
        value_ns = whole * unit + (int(part.ljust(18, "0")) * unit // 10**18 if part else 0)
        if layout.base_64:  # seconds as a float: what survives in it are microseconds
            value_ns = round(float(f"{whole}.{part or 0}") * 1e6) * 1000
        return -value_ns if match["sign"] else value_ns

    def _calendar(self, text: str) -> int:
        if (match := _ISO.match(text)) is not None:
            digits = re.sub(r"\D", "", match["date"])
            date = f"{digits[:4]}-{digits[4:6]}-{digits[6:]}"
            return self.clock.on(date, time_ns(*match.group(*_TIME)), match["zone"])
        if (match := _DAY.match(text)) is not None:
            return self.clock.on(_day_after(self.date, match["day"]), time_ns(*match.group(*_TIME)))
        if (match := _CLOCK.match(text)) is None:
            self.clock.zoneless = True
            return utc_ns(text)
        h, m, s, fraction = match.group(*_TIME)
        passed_ns = (int(h) * 3600 + int(m) * 60 + int(s)) * SECOND + nanoseconds(fraction)
        if self.mode == "RELATIVE":
            self.origin_ns += passed_ns
            return self.origin_ns
        return self.origin_ns + passed_ns if self.mode == "ABSOLUTE" else self.clock.at(passed_ns)


def _tokens(data: str) -> list[str]:
    """Hexadecimal numbers of one byte or more, without what is between them and 0x."""
    return re.sub(r"0x|[-:\[\]]", " ", data.lower()).split()


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENTS) and not line.startswith("***<")


def _iso(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns // SECOND, UTC).date().isoformat()


def _day_after(date: str, day: str) -> str:
    """The date with that day of the month from YYYYMMDD on; of 1970's January where there is no such date."""
    if not date:
        return f"1970-01-{day}"
    year, month = int(date[:4]), int(date[4:6])
    if day < date[6:]:
        year, month = year + month // 12, month % 12 + 1
    return f"{year:04d}-{month:02d}-{day}"


def _unit_by_size(whole: int) -> int:
    """What a whole number of unknown unit counts if it is a time of our days: ns; else seconds."""
    for digits, unit in ((17, 1), (14, 1_000), (11, 1_000_000)):
        if whole >= 10**digits:
            return unit
    return SECOND


def _cells(line: str, layout: ColumnLayout) -> list[str]:
    if layout.separator is None:
        return line.split()
    return [cell.strip().strip('"').strip() for cell in line.rstrip("\r\n").split(layout.separator)]


def _is_decimal(numbers: list[str], last: int) -> bool:
    """Whether these are decimal: not one has a hexadecimal digit, and as such some were too large."""
    bare = [number.lower().removesuffix("x") for number in numbers if number]
    if any(not number.isdecimal() for number in bare if _HEX.fullmatch(number) or number.startswith("0x")):
        return False
    return any(last < int(n, 16) and int(n) <= last for n in bare if n.isdecimal() and len(n) < 11)


def _number(text: str, base: int) -> int:
    return int(text, 16) if text.startswith("0x") else int(text, base)


def _split(line: str, layout: ColumnLayout) -> dict[Role, str]:
    """What a row holds. Raises LookupError for one that is too short."""
    return _by_blanks(line, layout) if layout.separator is None else _by_marks(line, layout)


def _by_marks(line: str, layout: ColumnLayout) -> dict[Role, str]:
    cells = _cells(line, layout)
    row: dict[Role, str] = {role: cells[at] for role, at in layout.places.items() if at < len(cells)}
    first = layout.data[0]
    if len(layout.data) > 1:
        row["data"] = " ".join(cells[at] for at in layout.data if at < len(cells))
    elif layout.spills:
        row["data"] = " ".join(cells[first:])
    else:
        row["data"] = cells[first]
    return row


def _by_blanks(line: str, layout: ColumnLayout) -> dict[Role, str]:
    """Flags may be none or many; they end where the length comes. What is behind the data is left alone."""
    cells = line.split()
    if "time" in layout.places and _ISO.match(f"{cells[0]} {cells[1]}"):
        cells[:2] = [f"{cells[0]} {cells[1]}"]
    last = layout.places["id"]
    row: dict[Role, str] = {role: cells[at] for role, at in layout.places.items() if at <= last}
    rest = cells[last + 1 :]
    if row["id"].lower() == "errorframe":
        row["error"] = "errorframe"
        return row
    count = next(at for at, cell in enumerate([*rest, "0"]) if cell.isdecimal())
    row["flags"] = " ".join(rest[:count])
    row["dlc"] = rest[count]
    data: list[str] = []
    for cell in rest[count + 1 :]:
        if not _HEX.fullmatch(cell):
            if cell.upper() == "RTR":
                row["flags"] += " rtr"
            break
        data.append(cell)
    length = int(row["dlc"][:3])
    row["data"] = " ".join(data[: length if length <= 8 else 64])
    return row


def _flags(row: dict[Role, str]) -> tuple[bool, bool, bool]:
    """(extended, remote, error)"""
    extended = is_so(row["extended"]) if "extended" in row else False
    remote = is_so(row["remote"]) if "remote" in row else False
    error = row.get("error", "").lower() == "errorframe" or ("error" in row and is_so(row["error"]))
    kind = row.get("type", "")
    if kind.isdecimal():  # of a CL2000: 1 extended, 8 sent
        return bool(int(kind) & 1), remote, error
    flags = row.get("flags", "")
    if flags.isdecimal():  # of canlib: 1 remote, 4 extended, 32 error
        return bool(int(flags) & 4), bool(int(flags) & 1), bool(int(flags) & 32)
    for word in f"{flags} {kind}".split():
        low = word.lower()
        extended = extended or low in ("x", "xr", "ext", "extended")
        remote = remote or low in ("sr", "xr", "r", "rtr", "remote")
        remote = remote or ("R" in word and set(word) <= set("EFBPRW#"))
        error = error or low in ("error", "errorframe")
    return extended, remote, error
