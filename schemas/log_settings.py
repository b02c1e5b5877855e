"""[log] of a machine file: where logs go, when a file is closed, how much is written at a time."""

from typing import Literal

from pydantic import Field

from tilth.schemas.section import Section


class Log(Section):
    folder: str = "logs"
    rotate_megabytes: float = Field(default=256.0, gt=0)
    rotate_minutes: float = Field(default=10.0, gt=0)
    ignition_off_s: float = Field(
        default=300.0,
        ge=0,
        description="no frame on any bus for so long means ignition off: the run's last file is finished, "
        "the next frame begins a new run; 0: never",
    )
    keep_free_megabytes: float = Field(default=200.0, ge=1, description="free space that is left alone")
    when_full: Literal["stop", "delete_oldest"] = Field(
        default="stop",
        description="stop recording and say so, or delete the oldest runs that are copied off or expired and "
        "not marked to be kept",
    )
    expire_days: float | None = Field(
        default=None, gt=0, description="after which a run that is not copied off may be deleted; else never"
    )
    chunk_kilobytes: int = Field(default=64, ge=1, le=4096)
