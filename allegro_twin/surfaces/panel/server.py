"""The front door: all that a browser reaches. One page, a stop, and the way to viser behind it; no files."""

from __future__ import annotations

import asyncio
import gzip
from asyncio import StreamReader, StreamWriter
from collections.abc import Callable
from contextlib import suppress

from allegro_twin.surfaces.panel.access import Answer, Gate
from allegro_twin.surfaces.panel.http_head import COOKIE, Request, answer, parsed

_PATIENCE, _LONGEST, _CHUNK = 10.0, 1 << 14, 1 << 16
"""s for a request's head, and bytes of it, and bytes that are passed on at once."""
_WORDS = {
    Answer.WRONG: "the panel needs its token: open the address that allegro-twin printed",
    Answer.ENOUGH: "too many wrong tokens from this address: wait a minute",
}


class Door:
    """Answers browsers. `names` are those by which one may have found it, so that no other page can be served under a
    name of its own that leads here; empty: any. `stop` is called for a stop, whoever sends it in."""

    def __init__(
        self,
        page: bytes,
        behind: tuple[str, int],
        gate: Gate,
        stop: Callable[[], None],
        names: tuple[str, ...] = (),
    ) -> None:
        self._page, self._behind, self._gate, self._stop, self._names = page, behind, gate, stop, names
        self._packed = gzip.compress(page, 6)

    async def __call__(self, reader: StreamReader, writer: StreamWriter) -> None:
        """One connection."""
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _PATIENCE)
            request = parsed(head)
            address = str((writer.get_extra_info("peername") or ("",))[0])
            found = answer(400, b"no request\n") if request is None else self._answered(request, address)
            if found is None:
                assert request is not None
                await self._through(request, reader, writer)
            else:
                writer.write(found)
                await writer.drain()
        except (TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, OSError):
            pass  # Who does not ask is not answered.
        finally:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()

    def _answered(self, request: Request, address: str) -> bytes | None:
        """What to say; None: let it through."""
        if self._names and request.name not in self._names:
            return answer(421, b"the panel is not served under this name\n")
        if request.from_elsewhere:
            return answer(403, b"another page may not drive the hand\n")
        verdict = self._gate.answer(address, request.token)
        if verdict is not Answer.WELCOME:
            return answer(verdict.value, (_WORDS[verdict] + "\n").encode())
        match request.method, request.path:
            case "POST", "/stop":
                self._stop()
                return answer(204)
            case "GET", "/" if request.upgrades:
                return None
            case "GET", "/" if "token" in request.query and self._gate.asks:
                kept = f"Set-Cookie: {COOKIE}={request.token}; HttpOnly; SameSite=Strict; Path=/"
                return answer(303, b"", "text/plain", kept, "Location: /")
            case "GET", "/":
                if "gzip" in request.headers.get("accept-encoding", ""):
                    return answer(200, self._packed, "text/html; charset=utf-8", "Content-Encoding: gzip")
                return answer(200, self._page, "text/html; charset=utf-8")
        return answer(404, b"there is nothing here\n")

    async def _through(self, request: Request, reader: StreamReader, writer: StreamWriter) -> None:
        inner_reader, inner_writer = await asyncio.open_connection(*self._behind)
        inner_writer.write(request.without_cookie())
        ways = [asyncio.create_task(_pass_on(reader, inner_writer)),
                asyncio.create_task(_pass_on(inner_reader, writer))]  # fmt: skip
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            inner_writer.close()


async def _pass_on(reader: StreamReader, writer: StreamWriter) -> None:
    with suppress(OSError):
        while chunk := await reader.read(_CHUNK):
            writer.write(chunk)
            await writer.drain()
