"""The one frame that this program ever sends, where the machine file allows it: who is there?

Devices claim their address when they are switched on. Whoever begins to listen later may ask for it: PGN
59904 for 60928, to everybody, from the address of those that have none (SAE J1939-81, 4.2.1).
"""

from collections.abc import Callable
from typing import Final

import can

from tilth.schemas.can_id import BROADCAST, NULL_ADDRESS, join

IDENTIFIER: Final = join(6, 59904, NULL_ADDRESS, BROADCAST)
DATA: Final = (60928).to_bytes(3, "little")


def ask(send: Callable[[], object]) -> str:
    """Send it by a bus's own means. Returns a remark where that fails: the bus is heard all the same."""
    try:
        send()
    except (OSError, can.CanError, NotImplementedError) as error:
        return f"devices could not be asked for their NAMEs ({error})"
    return ""
