"""Why frames, messages and measurements were not used: the codes that are counted by `rejected`."""

from enum import StrEnum


class Rejection(StrEnum):
    """`sentences/rejections.py` has the words. Readers of logs add codes of their own (docs/logs.md)."""

    # Of the decoder.
    NOT_AVAILABLE = "not_available"
    OUT_OF_RANGE = "out_of_range"
    SHORT_FRAME = "short_frame"
    ERROR_FRAME = "error_frame"
    UNIDENTIFIED = "unidentified"
    UNKNOWN_SOURCE = "unknown_source"
    QUARANTINE = "quarantine"
    TWIN_NAME = "twin_name"
    ADDRESS_CONFLICT = "address_conflict"
    REPEAT = "repeat"
    MAGNETIC = "magnetic"
    NO_REFERENCE = "no_reference"
    EARLY_DATE = "early_date"
    DUPLICATE_FRAME = "duplicate_frame"
    BROKEN_FAST_PACKET = "broken_fast_packet"
    STALE_FAST_PACKET = "stale_fast_packet"
    BROKEN_TRANSPORT = "broken_transport"
    STALE_TRANSPORT = "stale_transport"

    # Of the fold.
    SPIKE = "spike"
    STANDS_STILL = "stands_still"
    LATE = "late"
    CLOCK_STEP = "clock_step"
    OTHER_TIME = "other_time"
    NOT_A_NUMBER = "not_a_number"

    # Of the daemon.
    REMOTE = "remote"
    CAN_FD = "can_fd"
    GARBLED = "garbled"
    STAMP = "stamp"
    MARK = "mark"
    ACCEPT = "accept"
    IMPLEMENT = "implement"
    LOAD = "load"


def count(rejected: dict[str, int], reason: str, number: int = 1) -> None:
    """Count what is rejected under its reason."""
    rejected[reason] = rejected.get(reason, 0) + number
