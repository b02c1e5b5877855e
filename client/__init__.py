"""For controllers: receives what the daemon publishes over Zenoh, with a rule for what is too old to use.

See docs/client.md. `Client.connect` is the way in.
"""

from tilth.client.caution import Cautious, InForce, Limits
from tilth.client.client import Client
from tilth.client.latest import Latest, Linear, RefusalCode, Staleness, linear
from tilth.client.received import Antenna, HeardRig

__all__ = [
    "Antenna", "Cautious", "Client", "HeardRig", "InForce", "Latest", "Limits", "Linear", "RefusalCode",
    "Staleness",
    "linear",
]  # fmt: skip
