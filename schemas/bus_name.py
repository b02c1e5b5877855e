"""Names of buses: how a machine file can call a bus that another program has named."""

import re
from collections.abc import Collection
from typing import Final

BUS_NAME: Final = r"^[A-Za-z0-9_.-]+$"


def bus_name(text: str, others: Collection[str] = ()) -> str:
    """The name itself where it is one; else with "_" for what may not be in it, and unlike the others."""
    name = text if re.fullmatch(BUS_NAME[1:-1], text) else ""
    name = name or re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_") or "can"
    number, found = 1, name
    while found in others:
        number += 1
        found = f"{name}_{number}"
    return found
