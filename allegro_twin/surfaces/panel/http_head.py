"""The head of an HTTP request, and plain answers: as little of the protocol as a front door needs."""

from __future__ import annotations

from collections.abc import Mapping
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

COOKIE = "allegro_panel"


class Request(NamedTuple):
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
        """Of the computer, as the browser was told it."""
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


def parsed(head: bytes) -> Request | None:
    """None for what is no request."""
    first, *lines = head.decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        return None
    try:
        target = urlsplit(words[1])
        headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        query = {key: values[0] for key, values in parse_qs(target.query).items()}
        request = Request(words[0], target.path, query, headers, head)
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
