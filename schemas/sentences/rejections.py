"""Words of rejections (`schemas/rejections.py`)."""

from collections.abc import Mapping
from typing import Final

from tilth.schemas.rejections import Rejection
from tilth.schemas.sentences.reasons import ENGLISH

REJECTIONS: Final[Mapping[str, str]] = {
    Rejection.NOT_AVAILABLE: "the message says that it has no value",
    Rejection.OUT_OF_RANGE: "a value outside of its physical range",
    Rejection.SHORT_FRAME: "shorter than its layout",
    Rejection.ERROR_FRAME: "an error frame of the CAN controller",
    Rejection.UNIDENTIFIED: (
        "a manufacturer's own message (65535) from an address whose manufacturer is not known"
    ),
    Rejection.UNKNOWN_SOURCE: "from an address of no receiver or sensor in the machine file",
    Rejection.QUARANTINE: "from a receiver's address that somebody else has claimed",
    Rejection.TWIN_NAME: "from one of two devices that claim the same NAME",
    Rejection.ADDRESS_CONFLICT: "an address claim for an address that another NAME holds",
    Rejection.REPEAT: "a position that repeats the one before",
    Rejection.MAGNETIC: "a heading or course that counts from magnetic north",
    Rejection.NO_REFERENCE: "a heading or course that does not say which north it counts from",
    Rejection.EARLY_DATE: "a date before 2010: the receiver does not know the time yet",
    Rejection.DUPLICATE_FRAME: "an exact echo of the frame before, in a message of several frames",
    Rejection.BROKEN_FAST_PACKET: "a fast packet that lost a frame or got one out of order",
    Rejection.STALE_FAST_PACKET: "a fast packet that was not finished in time",
    Rejection.BROKEN_TRANSPORT: (
        "a transport-protocol message that lost a frame, got one out of order or was aborted"
    ),
    Rejection.STALE_TRANSPORT: "a transport-protocol message that was not finished in time",
    Rejection.SPIKE: (
        "a reading further from its neighbours than anything can move in between: cable, plug or sensor"
    ),
    Rejection.STANDS_STILL: "a reading that has stayed the same to the bit while the rig moves",
    Rejection.LATE: "a frame that came late: this computer, or the one that sends, was busy",
    Rejection.CLOCK_STEP: "the clock of the log stepped back",
    Rejection.OTHER_TIME: "a frame whose stamp is far from the log's time",
    Rejection.NOT_A_NUMBER: "a measurement with a value that is not a number",
    Rejection.REMOTE: "a remote frame: it asks for data and has none",
    Rejection.CAN_FD: "a frame of CAN FD, which is not read here",
    Rejection.GARBLED: "a line of an adapter that cannot be read",
    Rejection.STAMP: "an impossible stamp of an adapter: the computer's is used",
    Rejection.MARK: "a mark that was refused",
    Rejection.ACCEPT: "an order to accept that was refused",
    Rejection.IMPLEMENT: "an order to change the implement that was refused",
    Rejection.LOAD: "an entry of the implement's load that was refused",
}
LANGUAGES: Final[Mapping[str, Mapping[str, str]]] = {ENGLISH: REJECTIONS}


def rejection_sentence(reason: str, language: str = ENGLISH) -> str:
    """A reason with what it means, such as: late: a frame that …; those of readers of logs speak for
    themselves."""
    words = LANGUAGES[language].get(reason)
    return f"{reason}: {words}" if words else reason
