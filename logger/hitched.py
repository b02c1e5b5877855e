"""Which of a tractor's implements is hitched on: the one chosen last, until another is asked for or heard.

`<log folder>/<machine>.implement.txt` holds its name. With another implement a new run begins: a log is of
one rig, and replays by itself.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Final

from tilth.logger.clock import Clock
from tilth.logger.log import whole_file
from tilth.logger.log.marks import Marks, OrderWords
from tilth.logger.outlets import Outlets
from tilth.schemas.channels import CHANNEL
from tilth.schemas.device_names import device, of_implement
from tilth.schemas.flow import Event, EventKind
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import NoticeCode, Report, notice
from tilth.schemas.undescribed import UNDESCRIBED

KEY: Final = "implement"  # the last part of it
ORDER: Final = OrderWords("an order of an implement", "orders of implements", "the implement's name")
SETTLED_NS: Final = 10_000_000_000  # devices that are switched on together claim their addresses in this time

Rigs = Mapping[str, MachineFile]
"""Of one tractor, by the implement's name; one alone, by "", where its file has no [implements]."""


def path_of(folder: Path, machine: str) -> Path:
    return folder / f"{machine}.implement.txt"


def chosen(rigs: Rigs, folder: Path, report: Report) -> str:
    """The name of the one to begin with: as it was at last, else the first in the file, which is said."""
    first = next(iter(rigs))
    if len(rigs) == 1:
        return first
    try:
        name = whole_file.read(path_of(folder, rigs[first].machine.name)).decode().strip()
    except (OSError, UnicodeDecodeError):
        name = ""
    if name in rigs:
        return name
    report(EventKind.IMPLEMENT, notice(NoticeCode.IMPLEMENT_ASSUMED, implement=first, all=", ".join(rigs)))
    return first


class Hitched:
    """Asked for by a query on <prefix>/<machine>/implement with a name; or heard, by a NAME on the bus that
    is in the file of one implement alone, while none of the present one's is heard.

    The answer, a tilth.Event, comes when the choice is on the disk. `following` then names the implement of
    the run that is to begin; "" while this one goes on.
    """

    def __init__(
        self, rigs: Rigs | None, now: MachineFile, folder: Path, clock: Clock, outlets: Outlets
    ) -> None:
        """now: the one of this run. rigs: None where there is no other."""
        name = now.machine.implement.name or ""
        self.requests = Marks(ORDER)
        self.following = ""
        self.rigs = rigs or {name: now}
        self.name = name
        self._path = path_of(folder, now.machine.name)
        self._clock = clock
        self._outlets = outlets
        self._owners = _owners(self.rigs)
        self._in_files = {name for rig, _ in self.rigs.values() for name in _names(rig)}
        self._heard: dict[str, int] = {}  # implement -> one of its NAMEs
        self._strange: dict[int, int | None] = {}  # NAME in no file -> when it was heard; None: that is said
        self._since_ns: int | None = None  # when another than this one was heard first

    def heard(self, name: int | None) -> None:
        """A device with this NAME has sent something."""
        if name is None:
            return
        if (owner := self._owners.get(name)) is None:
            if name not in self._in_files and of_implement(name) and name not in self._strange:
                self._strange[name] = self._clock.t_ns()
            return
        self._heard[owner] = name
        if owner != self.name and self._since_ns is None:
            self._since_ns = self._clock.t_ns()

    def turn(self) -> None:
        """Log what is asked for, answer what is on the disk, take what is heard for hitched on."""
        for request in self.requests.requests():
            told = notice(NoticeCode.IMPLEMENT_CHANGED, implement=request.text)
            event = Event(self._clock.t_ns(), EventKind.IMPLEMENT, told)
            if refusal := self._refusal(request.text):
                self.requests.settle(request, event, refusal)
                continue
            self._keep(request.text, event)
            self._outlets.recording.settle(partial(self.requests.settle, request, event))
        for request, event, refusal in self.requests.settled():
            request.answer(event, refusal)
            if not refusal:
                self.following = request.text
        if self._since_ns is not None and self._clock.t_ns() - self._since_ns > SETTLED_NS:
            self._since_ns = None
            self._take_heard()

        for strange, heard_ns in self._strange.items():
            if heard_ns is not None and self._clock.t_ns() - heard_ns > SETTLED_NS:
                self._strange[strange] = None
                self._say_strange(strange)

    def _say_strange(self, name: int) -> None:
        """An implement that nobody has described is hitched on, if the present one would be heard by its own
        control units; else it may be."""
        if self.name in self._heard or self.following or self.name == UNDESCRIBED:
            return
        own = UNDESCRIBED in self.rigs and bool(self.rigs[self.name].machine.implement.names)
        code = NoticeCode.IMPLEMENT_UNDESCRIBED if own else NoticeCode.IMPLEMENT_STRANGE
        told = notice(
            code, device=device(name), name=f"{name:016X}",
            implement=self.name or "the machine file's implement",
        )  # fmt: skip
        event = Event(self._clock.t_ns(), EventKind.IMPLEMENT, told)
        if own:
            self._keep(UNDESCRIBED, event)
            self.following = UNDESCRIBED
            return
        self._outlets.put("/event", event.t_ns, CHANNEL["/event"].encode(event))
        self._outlets.show_event(event)

    def _take_heard(self) -> None:
        if self.name in self._heard or len(self._heard) != 1:
            return
        ((owner, name),) = self._heard.items()
        told = notice(NoticeCode.IMPLEMENT_HEARD, implement=owner, device=f"{name:016X}")
        self._keep(owner, Event(self._clock.t_ns(), EventKind.IMPLEMENT, told))
        self.following = owner

    def _keep(self, name: str, event: Event) -> None:
        self._outlets.put("/event", event.t_ns, CHANNEL["/event"].encode(event))
        self._outlets.show_event(event)
        self._outlets.recording.on_disk_thread(lambda: whole_file.write(self._path, name.encode()))

    def _refusal(self, name: str) -> str:
        if name == self.name:
            return f"{name} is hitched on already"
        if "" in self.rigs:
            return "the machine file has no [implements] to choose from"
        return "" if name in self.rigs else f"no implement {name}; there are {', '.join(self.rigs)}"


def _names(machine: Machine) -> set[int]:
    """Of all that is on an implement, as its file says."""
    own = (one.name for one in machine.receiver if one.mount.startswith("implement"))
    return {*machine.implement.names, *(name for name in own if name is not None)}


def _owners(rigs: Rigs) -> dict[int, str]:
    """NAME -> the implement whose file alone has it."""
    owners: dict[int, list[str]] = {}
    for implement, (machine, _) in rigs.items():
        for name in _names(machine) if implement != UNDESCRIBED else ():  # whose receivers are another's
            owners.setdefault(name, []).append(implement)
    return {name: found[0] for name, found in owners.items() if len(found) == 1}
