"""The flags of a pose, which go over the wire as `kind` or `kind:place` (docs/notation.md lists them)."""

from typing import NamedTuple


class PoseFlag(NamedTuple):
    kind: str  # such as "lost"
    place: str = ""  # a mount or a body; "" where the kind concerns the whole pose


def parse_flag(text: str) -> PoseFlag:
    """A flag from the wire. An unknown kind is kept: daemons of a later version may have more."""
    kind, _, place = text.partition(":")
    return PoseFlag(kind, place)
