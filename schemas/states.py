"""States that tilth.Status carries as words."""

from enum import StrEnum


class DeviceState(StrEnum):
    """Of a receiver or of the wheel-angle sensor: the words of tilth.ReceiverStatus."""

    ALIVE = "alive"
    NO_DATA = "no_data"  # it sends, but no position or no angle
    LOST = "lost"
    WAITING = "waiting"  # never heard in this run


class RunHealth(StrEnum):
    """Of the whole daemon, for whoever watches from afar: the words of tilth.Status.health."""

    GOOD = "good"
    DEGRADED = "degraded"
    BAD = "bad"
