"""The panel's HTTP server: one page, the stop, a sign of life, and a tunnel to viser behind it; it serves no files."""

from __future__ import annotations

import asyncio
import gzip
from asyncio import StreamReader, StreamWriter
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

from allegro_twin.surfaces.panel.access import Access, TokenGate

_PATIENCE, _LONGEST, _CHUNK = 10.0, 1 << 14, 1 << 16
"""s for a request's head, and bytes of it, and bytes that are passed on at once."""
COOKIE = "allegro_panel"
_WORDS = {
    Access.WRONG: "the panel needs its token: open the address that allegro-twin printed",
    Access.ENOUGH: "too many wrong tokens from this address: wait a minute",
}


class PanelServer:
    """Answers browsers. `names` are those by which one may have found it, so that no other page can be served under a
    name of its own that leads here; empty: any. `stop` is called for a stop, whoever sends it in."""

    def __init__(
        self,
        page: bytes,
        behind: tuple[str, int],
        gate: TokenGate,
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

    def _answered(self, request: HttpRequest, address: str) -> bytes | None:
        """What to say; None: let it through."""
        if self._names and request.name not in self._names:
            return answer(421, b"the panel is not served under this name\n")
        if request.from_elsewhere:
            return answer(403, b"another page may not drive the hand\n")
        verdict = self._gate.answer(address, request.token)
        if verdict is not Access.WELCOME:
            return answer(verdict.value, (_WORDS[verdict] + "\n").encode())
        match request.method, request.path:
            case "POST", "/stop":
                self._stop()
                return answer(204)
            case "GET", "/alive":
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

    async def _through(self, request: HttpRequest, reader: StreamReader, writer: StreamWriter) -> None:
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


class HttpRequest(NamedTuple):
    """The head of an HTTP request."""

    method: str
    path: str
    query: Mapping[str, str]
    headers: Mapping[str, str]
    """Names in small letters."""
    head: bytes
    """As it came, with the empty line."""

    @property
    def token(self) -> str:
        """That it brings, in its address or its cookie; empty: none."""
        if "token" in self.query:
            return self.query["token"]
        try:
            cookie = SimpleCookie(self.headers.get("cookie", ""))
        except CookieError:
            return ""
        return cookie[COOKIE].value if COOKIE in cookie else ""

    @property
    def upgrades(self) -> bool:
        return self.headers.get("upgrade", "").lower() == "websocket"

    @property
    def name(self) -> str:
        """Name of the computer as the browser knows it."""
        return urlsplit(f"//{self.headers.get('host', '')}").hostname or ""

    @property
    def from_elsewhere(self) -> bool:
        """Whether a page of another origin sent it: a browser says so, and no page can keep it from that."""
        origin = self.headers.get("origin")
        return origin is not None and urlsplit(origin).netloc != self.headers.get("host")

    def without_cookie(self) -> bytes:
        """The head for whoever is behind the door, who needs no token."""
        lines = self.head.split(b"\r\n")
        return b"\r\n".join(line for line in lines if not line.lower().startswith(b"cookie:"))


def parsed(head: bytes) -> HttpRequest | None:
    """None for what is no request."""
    first, *lines = head.decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        return None
    try:
        target = urlsplit(words[1])
        headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        query = {key: values[0] for key, values in parse_qs(target.query).items()}
        request = HttpRequest(words[0], target.path, query, headers, head)
        _ = request.name, request.from_elsewhere
    except ValueError:
        return None
    return request


def answer(status: int, body: bytes = b"", kind: str = "text/plain; charset=utf-8", *more: str) -> bytes:
    """A whole answer; `more` are further lines of its head."""
    head = [
        f"HTTP/1.1 {status} {HTTPStatus(status).phrase}",
        f"Content-Type: {kind}",
        f"Content-Length: {len(body)}",
        "Connection: close",
        "Cache-Control: no-store",
        "X-Content-Type-Options: nosniff",
        "X-Frame-Options: DENY",
        "Referrer-Policy: no-referrer",
        *more,
    ]
    return "\r\n".join([*head, "", ""]).encode() + body
