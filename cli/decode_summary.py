"""What `tilth decode` shows on a terminal: who sent which message how often, and what its last one said."""

from dataclasses import dataclass, field
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilth.schemas.device_names import device
from tilth.schemas.flow import Message

CLAIM: Final = 60928
_VALUES: Final = 4  # of a message that are shown


@dataclass(slots=True)
class _Heard:
    first_ns: int
    last: Message
    count: int = 0

    @property
    def rate(self) -> str:
        seconds = 1e-9 * (self.last.t_ns - self.first_ns)
        return f"{(self.count - 1) / seconds:.3g}" if seconds > 0 and self.count > 1 else ""


@dataclass(slots=True)
class Summary:
    """A row for each sender and message, in the order in which they were first heard."""

    rows: dict[tuple[str, int, str | None, int, str], _Heard] = field(default_factory=dict)

    def take(self, message: Message) -> str:
        """Returns what is to be printed of it: nothing yet."""
        key = message.origin.bus, message.origin.source, name_text(message), message.pgn, message.title
        row = self.rows.setdefault(key, _Heard(message.t_ns, message))
        row.count, row.last = row.count + 1, message
        return ""

    def show(self) -> None:
        """To stdout."""
        table = Table(box=None, padding=(0, 1, 0, 0))
        table.add_column("bus", no_wrap=True)
        for heading in ("source", "PGN", "messages", "a second"):
            table.add_column(heading, justify="right", no_wrap=True)
        table.add_column("what, and its last values", overflow="fold")
        for (bus, source, _, pgn, title), row in sorted(self.rows.items(), key=lambda item: item[0][:2]):
            told = Text.assemble(title, "  ", (_told(row.last), "dim"))
            table.add_row(bus, str(source), str(pgn), str(row.count), row.rate, told)
        Console().print(table)


def name_text(message: Message) -> str | None:
    """NAME of the sender, 16 hexadecimal digits; None where it is not known."""
    return None if message.origin.name is None else f"{message.origin.name:016X}"


def _told(message: Message) -> str:
    name = message.origin.name
    if message.pgn == CLAIM and name is not None:
        return device(name)
    return "  ".join(f"{word}={short(value)}" for word, value in list(message.values.items())[:_VALUES])


def short(value: object) -> str:
    """Of a message, for people."""
    return f"{value:.9g}" if isinstance(value, float) else str(value)
