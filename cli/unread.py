"""What is said of frames that were not decoded, by PGN with its name and by source, or that were rejected."""

from collections import Counter
from collections.abc import Callable, Mapping

from tilth.schemas.decode import Decoder, Unread
from tilth.schemas.device_names import device, name_words
from tilth.schemas.flow import Origin
from tilth.schemas.pgn_titles import is_proprietary, title_of

NO_SOURCE = -1  # of frames of 11 bits


def tell_unread(unread: Mapping[Unread, int], decoder: Decoder, say: Callable[[str], None]) -> None:
    """Frames of each PGN and of each source, the most first. decoder: knows who has which address."""
    of_pgn, of_source = Counter[tuple[bool, int]](), Counter[tuple[str, int]]()
    senders: dict[tuple[bool, int], dict[tuple[str, int], None]] = {}
    for (bus, source, pgn), frames in unread.items():
        key = (source == NO_SOURCE, pgn)
        of_pgn[key] += frames
        of_source[bus, source] += frames
        senders.setdefault(key, {})[bus, source] = None
    if not of_pgn:
        return
    say(f"not decoded: {of_pgn.total()} frames ({len(of_pgn)} PGNs); --help lists what is decoded")
    for (short, pgn), frames in sorted(of_pgn.items(), key=_most_first):
        say(f"not decoded: {_title(short, pgn, senders[short, pgn], decoder)}: {frames}")
    for (bus, source), frames in sorted(of_source.items(), key=_most_first):
        say(f"not decoded from {who(decoder.origin(bus, source))}: {frames}")


def _most_first(item: tuple[tuple[object, int], int]) -> tuple[int, object, int]:
    (first, second), frames = item
    return -frames, first, second


def _title(short: bool, pgn: int, senders: Mapping[tuple[str, int], None], decoder: Decoder) -> str:
    if short:
        return f"identifier 0x{pgn:03X} of 11 bits"
    title = title_of(pgn) or "name not known here"
    if is_proprietary(pgn):
        names = (decoder.origin(bus, source).name for bus, source in senders)
        makers = (name_words(name).get("manufacturer_name") for name in names if name is not None)
        whose = ", ".join(sorted({maker for maker in makers if maker}))
        title += f", of {whose}" if whose else ""
    return f"{pgn} {title}"


def who(origin: Origin) -> str:
    """A sender for people, such as "can0 address 28, A00017000421E240 (John Deere, navigation)"."""
    if origin.source == NO_SOURCE:
        return f"{origin.bus} by identifiers of 11 bits"
    place = f"{origin.bus} address {origin.source}"
    return place if origin.name is None else f"{place}, {origin.name:016X} ({device(origin.name)})"
