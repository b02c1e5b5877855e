"""What the data say against a machine file: a typed record, of which `sentences/` makes words."""

from dataclasses import dataclass
from enum import StrEnum

from tilth.schemas.reasons import Code, Reason


class DiagnosisState(StrEnum):
    """Of a file, or of one thing that may be wrong with it."""

    UNCONFIRMED = "unconfirmed"  # driving has not been such that a gross error would have shown
    CONFIRMED = "confirmed"
    SUSPECTED = "suspected"  # found, but not for long enough, or several things explain it
    ISOLATED = "isolated"  # it is this
    CLEARED = "cleared"  # it is over


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One thing that is wrong. Amounts and sds are SI."""

    code: Code
    key: str  # of the machine file, by which it is known
    of: tuple[str, ...] = ()  # who: as its code says
    numbers: tuple[str, ...] = ()  # of the rig (estimator/rig/numbers.py), that are concerned
    amounts: tuple[float, ...] = ()  # by how much
    sds: tuple[float, ...] = ()  # of them, or none
    since_ns: int = 0
    state: DiagnosisState = DiagnosisState.SUSPECTED

    @property
    def reason(self) -> Reason:
        """Why there is no number."""
        return Reason(self.code, (self.key, *self.of), (*self.amounts, *self.sds))
