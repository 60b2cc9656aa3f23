"""A browser reaches one page, a stop and what is behind the door; no file of the machine, and not from another page."""

from __future__ import annotations

import asyncio
import gzip
from collections.abc import Awaitable, Callable

import pytest

from allegro_twin.surfaces.panel.access import TRIES, TokenGate
from allegro_twin.surfaces.panel.overlay import page
from allegro_twin.surfaces.panel.server import PanelServer

PAGE = b"<html>the page</html>"
TOKEN = "a-token-of-some-length"
Ask = Callable[[str], Awaitable[bytes]]


def asked(steps: Callable[[Ask], Awaitable[None]], token: str | None = None, stops: list[int] | None = None) -> None:
    """Run some steps against a door in front of an echo."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"behind: " + await reader.readuntil(b"\r\n\r\n"))
        await writer.drain()
        writer.write(await reader.read(100))
        await writer.drain()
        writer.close()

    async def run() -> None:
        behind = await asyncio.start_server(echo, "127.0.0.1", 0)
        names = ("127.0.0.1", "localhost") if token is None else ()
        gate = TokenGate(token, asyncio.get_running_loop().time)
        door = PanelServer(PAGE, behind.sockets[0].getsockname(), gate, lambda: (stops or []).append(1), names)
        front = await asyncio.start_server(door, "127.0.0.1", 0, limit=1 << 14)
        port = front.sockets[0].getsockname()[1]

        async def ask(text: str) -> bytes:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(text.replace("\n", "\r\n").encode())
            await writer.drain()
            answer = await asyncio.wait_for(reader.read(), 10.0)
            writer.close()
            return answer

        async with behind, front:
            await steps(ask)

    asyncio.run(run())


def get(path: str, *more: str, host: str = "127.0.0.1:80", method: str = "GET") -> str:
    return "\n".join([f"{method} {path} HTTP/1.1", f"Host: {host}", *more, "", ""])


def status(answer: bytes) -> int:
    return int(answer.split(b" ")[1])


def test_the_page_is_at_the_root() -> None:
    async def steps(ask: Ask) -> None:
        answer = await ask(get("/"))
        assert status(answer) == 200
        assert answer.endswith(PAGE)
        packed = await ask(get("/", "Accept-Encoding: gzip"))
        assert gzip.decompress(packed.split(b"\r\n\r\n", 1)[1]) == PAGE

    asked(steps)


@pytest.mark.parametrize(
    "path",
    ["/../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/..%5c..%5cetc", "/index.html",
     "/etc/passwd", "/./",
     "/?/../../etc/passwd", "file:///etc/passwd", "http://127.0.0.1/etc/passwd", "/%00", "/static/../x"],
)  # fmt: skip
def test_no_path_leads_to_a_file(path: str) -> None:
    async def steps(ask: Ask) -> None:
        answer = await ask(get(path))
        assert b"root:" not in answer
        assert status(answer) == 404 or answer.endswith(PAGE)

    asked(steps)


def test_a_stop_needs_no_more_than_a_post_and_nothing_else_stops() -> None:
    stops: list[int] = [0]

    async def steps(ask: Ask) -> None:
        assert status(await ask(get("/stop"))) == 404
        assert stops == [0]
        assert status(await ask(get("/stop", method="POST"))) == 204
        assert stops == [0, 1]

    asked(steps, stops=stops)


def test_a_sign_of_life_is_given_to_whoever_may_see_the_page() -> None:
    async def open_to_all(ask: Ask) -> None:
        assert status(await ask(get("/alive"))) == 204

    async def with_a_token(ask: Ask) -> None:
        assert status(await ask(get("/alive"))) != 204
        assert status(await ask(get(f"/alive?token={TOKEN}"))) == 204

    asked(open_to_all)
    asked(with_a_token, TOKEN)


def test_a_websocket_is_led_to_what_is_behind_without_the_cookie() -> None:
    async def steps(ask: Ask) -> None:
        request = get("/", "Upgrade: websocket", f"Cookie: allegro_panel={TOKEN}")
        answer = await ask(request + "first bytes")
        assert answer.startswith(b"behind: GET / HTTP/1.1\r\n")
        assert answer.endswith(b"first bytes")
        assert TOKEN.encode() not in answer

    asked(steps, token=TOKEN)


@pytest.mark.parametrize("more", [("Upgrade: websocket",), ()])
def test_another_page_cannot_reach_the_hand_through_its_visitors_browser(more: tuple[str, ...]) -> None:
    async def steps(ask: Ask) -> None:
        assert status(await ask(get("/", "Origin: http://elsewhere.example", *more))) == 403
        assert status(await ask(get("/stop", "Origin: null", *more, method="POST"))) == 403
        assert status(await ask(get("/", *more, host="elsewhere.example"))) == 421
        assert status(await ask(get("/", "Origin: http://127.0.0.1:80"))) == 200

    asked(steps)


def test_with_a_token_nothing_is_answered_without_it() -> None:
    stops: list[int] = [0]

    async def steps(ask: Ask) -> None:
        for request in (get("/"), get("/stop", method="POST"), get("/", "Upgrade: websocket"), get("/?token=wrong")):
            answer = await ask(request)
            assert status(answer) == 403
            assert b"needs its token" in answer
        assert stops == [0]

    asked(steps, token=TOKEN, stops=stops)


def test_the_token_is_brought_once_and_kept_in_a_cookie_that_no_script_reads() -> None:
    async def steps(ask: Ask) -> None:
        answer = await ask(get(f"/?token={TOKEN}"))
        assert status(answer) == 303
        assert f"Set-Cookie: allegro_panel={TOKEN}; HttpOnly; SameSite=Strict".encode() in answer
        assert status(await ask(get("/", f"Cookie: other=1; allegro_panel={TOKEN}"))) == 200

    asked(steps, token=TOKEN)


def test_a_thousand_guesses_are_answered_clearly_and_stop_nobody_else() -> None:
    async def steps(ask: Ask) -> None:
        answers = [await ask(get(f"/?token=guess{k}")) for k in range(1000)]
        said = [status(answer) for answer in answers]
        assert said == [403] * TRIES + [429] * (1000 - TRIES)
        assert b"wait a minute" in answers[-1]

    asked(steps, token=TOKEN)


@pytest.mark.parametrize("text", ["nonsense\n\n", "GET /\n\n", "GET http://[ HTTP/1.1\n\n", "\x00\x01\n\n"])
def test_what_is_no_request_is_told_so(text: str) -> None:
    async def steps(ask: Ask) -> None:
        assert status(await ask(text)) == 400

    asked(steps)


def test_a_head_that_never_ends_is_given_up() -> None:
    async def steps(ask: Ask) -> None:
        assert await ask(get("/", "X: " + "a" * 40000)) == b""

    asked(steps)


def test_the_stop_lies_over_whatever_page_is_served() -> None:
    made = page("<html><head><title>Viser</title></head><body><p></p></body></html>").decode()
    assert made.index('id="stop"') < made.index("</body>")
    assert "<title>Allegro hand</title>" in made
