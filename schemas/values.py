"""`dataclass` of what is made by the thousand each second and changed by nobody: frames, measurements, poses.

Type checkers take it for the one of the standard library, so they hold `frozen=True`. Python itself does not:
there a frozen object sets each field by a call, and is made in four times the time.
"""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(*, frozen: bool = False, **options: Any) -> Callable[[type], type]:
        """As dataclasses.dataclass; frozen gives the hash, and nothing else."""
        return dataclasses.dataclass(unsafe_hash=frozen, **options)
