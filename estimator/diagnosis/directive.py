"""What the diagnosis tells the fold to do: the same to every stage, at one place."""

from dataclasses import dataclass, field

from tilth.schemas.notices import Notice


@dataclass(slots=True)
class Directive:
    """Of one look. What it does not say stays as it is."""

    events: list[tuple[str, Notice]] = field(default_factory=list)  # by kind, with the place of the tractor
    exclude: frozenset[str] | None = None  # mounts whose receivers give no poses from here on
    lagging: frozenset[str] | None = None  # mounts whose turn rates are not used from here on
    reset: bool = False  # the methods begin anew: they have learned from wrong measurements
    reset_open: bool = False  # so does the open tracker
    withhold: bool = False  # nothing is learned from this pose
