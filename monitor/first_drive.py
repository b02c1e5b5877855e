"""What the page shows until the daemon of a demo is ready: a recorded drive that says what it is."""

from concurrent.futures import Future, ThreadPoolExecutor

from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.view import FIRST_DRIVE, Turn, View
from tilth.schemas.proto import tilth_pb2 as pb


class FirstDrive:
    """The view of a player, over and over, then that of the daemon. For server.serve."""

    def __init__(self, player: DaemonData, recorded: View, live: View) -> None:
        """live: of the daemon that gets ready meanwhile."""
        self._player, self._recorded, self._live = player, recorded, live
        self._is_ready = False
        self._asking = ThreadPoolExecutor(1, "tilth.first_drive")
        self._again: Future[str] | None = None

    def whole(self, now_s: float) -> str:
        return (self._live if self._is_ready else self._recorded).whole(now_s)

    def turn(self, now_s: float) -> Turn:
        live = self._live.turn(now_s)
        if self._is_ready:
            return live
        status = self._live.last("status") or {}
        if status and not status["preparing"]:
            self._is_ready = True
            return live._replace(anew=True)
        self._tell({key: status[key] for key in ("preparing", "ready_in_s", "recording") if key in status})
        self._play_again()
        return self._recorded.turn(now_s)

    def _tell(self, getting_ready: dict[str, object]) -> None:
        if getting_ready != self._recorded.last(FIRST_DRIVE):
            self._recorded.tell(FIRST_DRIVE, getting_ready)

    def _play_again(self) -> None:
        """Where it has come to its end."""
        state = (self._recorded.last("player") or {}).get("state")
        if state == "ended" and (self._again is None or self._again.done()):
            self._again = self._asking.submit(self._player.order, pb.PlayerOrder(kind="play"))
