"""A door before a WebSocket server that would let in whoever connects.

It reads who asks, and then is but a wire. The server behind it listens on an address of loopback that is
drawn anew each time, where no page in a browser finds it by trying.
"""

import asyncio
import contextlib
import secrets
import sys
import threading
from collections.abc import Callable, Sequence
from email.parser import BytesParser
from http import HTTPStatus
from typing import Final

from tilth.monitor.origin import Refusal, refusal
from tilth.schemas.limiter import Limiter, of_address

HEAD_S: Final = 5.0  # to say who asks
HEAD_BYTES: Final = 16 * 1024
VIEWERS: Final = 16
EACH: Final = 8  # of them, of one computer
_PIECE: Final = 65536


def hidden_host() -> str:
    """Where the server behind the door listens. Systems other than Linux have one such address only."""
    drawn = f"127.{1 + secrets.randbelow(254)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
    return drawn if sys.platform == "linux" else "127.0.0.1"


class Gate:
    """Listens until it is stopped, in a thread of its own."""

    def __init__(
        self,
        host: str,
        port: int,
        behind: tuple[str, int],
        allowed: Sequence[str],
        refused: Callable[[Refusal, str], None],
    ) -> None:
        """behind: host and port of the server. allowed: as of origin.refusal. refused: is told what was not
        let in and its origin, "" where it said none. Raises OSError."""
        self._behind, self._allowed, self._refused = behind, tuple(map(str.lower, allowed)), refused
        self._viewers: set[asyncio.Task[None]] = set()
        self._limiter = Limiter(VIEWERS, EACH, "viewers")
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(
                asyncio.start_server(self._take, host, port, limit=HEAD_BYTES)
            )
        except OSError:
            self._loop.close()
            raise
        self.port = int(self._server.sockets[0].getsockname()[1])
        self._thread = threading.Thread(target=self._loop.run_forever, name="tilth.gate", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ends every connection."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        for viewer in self._viewers:
            viewer.cancel()
        await asyncio.gather(*self._viewers, return_exceptions=True)

    def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        viewer = self._loop.create_task(self._serve(reader, writer))
        self._viewers.add(viewer)
        viewer.add_done_callback(self._viewers.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):  # either side may go whenever it likes
            client = of_address((writer.get_extra_info("peername") or [""])[0])
            full = self._limiter.enter(client)
            try:
                head = await self._head(full, reader, writer)
                if head:
                    await self._connect(head, reader, writer)
            finally:
                if not full:
                    self._limiter.leave(client)
                writer.close()

    async def _head(self, full: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        """The request as far as it says who asks; b"" where it was refused. full: why there is no place."""
        head, origins = b"", list[str]()
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
            fields = BytesParser().parsebytes(head.partition(b"\r\n")[2], headersonly=True)
            origins = list(map(str, fields.get_all("origin", [])))
            refused = refusal(list(map(str, fields.get_all("host", []))), origins, self._allowed)
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            refused = Refusal(HTTPStatus.BAD_REQUEST, "not a request of a viewer")
        if refused is None and full:
            refused = Refusal(HTTPStatus.SERVICE_UNAVAILABLE, full)
        if refused is None:
            return head
        self._refused(refused, ", ".join(origins))
        status, text = HTTPStatus(refused.status), f"{refused.why}\n".encode()
        writer.write(
            f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain\r\n"
            f"Content-Length: {len(text)}\r\nConnection: close\r\n\r\n".encode()
            + text
        )
        await writer.drain()
        return b""

    async def _connect(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        answers, asks = await asyncio.open_connection(*self._behind)
        try:
            asks.write(head)
            pipes = [asyncio.create_task(_pipe(*ends)) for ends in ((reader, asks), (answers, writer))]
            try:
                await asyncio.wait(pipes, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for pipe in pipes:
                    pipe.cancel()
                await asyncio.gather(*pipes, return_exceptions=True)
        finally:
            asks.close()


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(_PIECE):
        writer.write(data)
        await writer.drain()
