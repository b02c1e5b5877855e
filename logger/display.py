"""The interface of a display of the daemon; status_line.py has two implementations."""

from typing import Protocol

from tilth.schemas.flow import Estimate, Event
from tilth.schemas.proto import tilth_pb2 as pb


class Display(Protocol):
    """Where a person looks."""

    def show(self, status: pb.Status, estimate: Estimate | None) -> None: ...

    def event(self, event: Event) -> None: ...


class NoDisplay:
    """Shows nothing: for tests and for a daemon inside another program."""

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        return

    def event(self, event: Event) -> None:
        return
