"""How long something has to be found before it is believed, and to be missing before it is over.

One thing that may be wrong is suspected, isolated and cleared (`DiagnosisState`). All that look for what is
wrong count here: with each pose, each block of the watch, each stretch from turn to turn.
"""

from dataclasses import dataclass, field, replace

from tilth.schemas.diagnosis import Diagnosis, DiagnosisState


@dataclass(slots=True)
class Persistence:
    """In how many looks in a row something was found, or was not."""

    seen: int = 0
    absent: int = 0

    def look(self, found: bool) -> None:
        """One more."""
        self.seen, self.absent = (self.seen + 1, 0) if found else (0, self.absent + 1)


@dataclass(slots=True)
class FaultCase:
    """One thing that may be wrong, from when it is found first until it is over."""

    diagnosis: Diagnosis  # as it was found last, until it is isolated
    latest: Diagnosis  # as it was found last
    looks: Persistence = field(default_factory=Persistence)
    lasted: int = 0  # looks since it was isolated

    @property
    def isolated(self) -> bool:
        """Whether it has been found for long enough, and is not over."""
        return self.diagnosis.state is DiagnosisState.ISOLATED

    def found(self, one: Diagnosis, begins: int) -> bool:
        """It is found once more. Whether it is isolated with that: the begins-th look in a row."""
        self.latest = one
        self.looks.look(True)
        if self.isolated:
            self.lasted += 1
            return False
        isolated = self.looks.seen >= begins
        state = DiagnosisState.ISOLATED if isolated else DiagnosisState.SUSPECTED
        self.diagnosis = replace(one, since_ns=self.diagnosis.since_ns, state=state)
        self.lasted += isolated
        return isolated

    def missing(self, ends: int) -> bool:
        """It is not found. Whether it is over: at once, or in the ends-th look in a row if it is isolated."""
        self.looks.look(False)
        self.lasted += self.isolated
        return not self.isolated or self.looks.absent >= ends
