"""`<log folder>/<machine>.addresses.json`: who has which address of which bus, for the next run.

Devices claim their address when they are switched on. A daemon that begins later, or again, has not heard it.
The file tells it, and when each bus was heard last: by that a run knows whether the devices have been
switched off since. Times are on the clock of this start of the computer; after another start nobody knows how
long it was off, and what is kept is an assumption.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.logger.clock import Clock, boot_id
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log import whole_file
from tilth.logger.log.run_log import Recording
from tilth.schemas.flow import EventKind
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import NoticeCode, Report, notice

FORMAT: Final = 1
EVERY_NS: Final = 30_000_000_000  # or more often, where ignition off is shorter
SHARE: Final = 8  # of the time after which ignition is off


class AddressMemory:
    """Kept current while the daemon runs."""

    def __init__(
        self, folder: Path, machine_file: MachineFile, fold: GuardedFold, clock: Clock, report: Report
    ) -> None:
        machine = machine_file.machine
        self._path = folder / f"{machine.name}.addresses.json"
        self._sha256 = machine_file.sha256
        self._fold = fold
        self._clock = clock
        self._report = report
        ignition_ns = int(machine.log.ignition_off_s * 1e9)
        self._every_ns = min(EVERY_NS, ignition_ns // SHARE) if ignition_ns else EVERY_NS
        self._next_ns = 0
        self._written: list[KnownAddress] = []  # without times

    def take_up(self) -> bool:
        """Before the first frame: tell the fold what was known. Whether there was anything."""
        try:
            known = read(self._path, self._sha256, self._clock)
        except (OSError, ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            unreadable = notice(NoticeCode.ADDRESSES_UNREADABLE, file=str(self._path), error=str(error))
            self._report(EventKind.ADDRESSES, unreadable)
            return False
        self._fold.recall(known)
        return bool(known)

    def turn(self, t_ns: int, recording: Recording) -> None:
        """Write it, in the thread that waits for the disk, where it is due: at once when something is new."""
        known = self._fold.known_addresses
        plain = [replace(one, last_ns=0) for one in known]
        if not known or (t_ns < self._next_ns and plain == self._written):
            return
        self._next_ns, self._written = t_ns + self._every_ns, plain
        text = text_of(known, self._sha256, self._clock)
        recording.on_disk_thread(lambda: whole_file.write(self._path, text.encode()))


def text_of(known: Sequence[KnownAddress], sha256: str, clock: Clock) -> str:
    """What is to be written. Times are on the clock of this start of the computer there."""
    ahead_ns = _boottime_ns() - clock.t_ns()
    kept = [replace(one, last_ns=one.last_ns and one.last_ns + ahead_ns) for one in known]
    plain = {
        "format": FORMAT,
        "machine_sha256": sha256,
        "boot_id": boot_id(),
        "known": [
            to_json_data(one) | {"name": None if one.name is None else f"{one.name:016X}"} for one in kept
        ],
    }
    return json.dumps(plain, indent=1)


def read(path: Path, sha256: str, clock: Clock) -> list[KnownAddress]:
    """What was kept, its times on this clock; [] where nothing was. With another machine file only the NAMEs
    count. Raises OSError, or for another text what its parts raise."""
    try:
        plain = json.loads(whole_file.read(path))
    except FileNotFoundError:
        return []
    if plain["format"] != FORMAT:
        raise ValueError("it is of another version of tilth")
    same_file, same_start = plain["machine_sha256"] == sha256, plain["boot_id"] == boot_id() != ""
    behind_ns = clock.t_ns() - _boottime_ns()
    out = []
    for row in plain["known"]:
        name = None if row["name"] is None else int(row["name"], 16)
        one: KnownAddress = from_json_data(KnownAddress, row | {"name": name})
        last_ns = one.last_ns + behind_ns if same_start and one.last_ns else 0
        out.append(replace(one, last_ns=last_ns, mount=one.mount if same_file else None))
    return out


def _boottime_ns() -> int:
    """It counts while the computer sleeps, too."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
