"""Listens to buses in a thread of its own, for who asks now and then what is heard. Nothing is ever sent."""

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tilth.logger.can import can_link
from tilth.replay.discover import BusSurvey, Findings, listen
from tilth.schemas.machine import Bus
from tilth.schemas.notices import Notice, NoticeCode
from tilth.schemas.sentences import notice_sentence

LONGEST_S: Final = 600.0  # a survey holds what it hears
TROUBLE: Final = (NoticeCode.BUS_FAILED, NoticeCode.BUS_TROUBLE)
ARPHRD_CAN: Final = "280"  # linux/if_arp.h


def interfaces() -> list[tuple[str, int]]:
    """CAN interfaces that this computer has, and the bit rate of each, bit/s; 0 where none is set."""
    found = []
    for path in sorted(Path("/sys/class/net").glob("*/type")):
        if path.read_text().strip() == ARPHRD_CAN:
            link = can_link.ask(path.parent.name)
            found.append((path.parent.name, 0 if link is None else link.bitrate))
    return found


class BusListening:
    """One survey at a time. `start` begins one anew."""

    def __init__(self, buses: Sequence[Bus], seconds: float = LONGEST_S) -> None:
        self.buses, self._seconds = buses, seconds
        self._lock = threading.Lock()
        self._survey = BusSurvey()
        self._problems: dict[str, str] = {}
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    @property
    def listens(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """What was heard before is forgotten."""
        self.stop()
        self._stopping.clear()
        self._survey, self._problems = BusSurvey(), {}
        self._thread = threading.Thread(target=self._run, name="tilth.listening", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def findings(self) -> Findings:
        """So far."""
        with self._lock:
            return self._survey.findings()

    def problems(self) -> list[str]:
        """The last of each bus that has one, a sentence."""
        return list(self._problems.values())

    def _note(self, kind: str, told: Notice) -> None:
        if told.code in TROUBLE:
            self._problems[str(told.values.get("bus", ""))] = notice_sentence(told)

    def _run(self) -> None:
        frames = listen(
            self.buses,
            self._seconds,
            self._note,
            self._stopping.is_set,
        )
        for frame in frames:
            with self._lock:
                self._survey.take(frame)
