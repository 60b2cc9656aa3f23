"""Access tokens of the panel: they are compared in constant time, and guessing is slowed down."""

from __future__ import annotations

import hmac
from collections import OrderedDict
from collections.abc import Callable
from enum import Enum

from allegro_twin.errors import ConfigError

TRIES, REST = 10, 60.0
"""Wrong tokens from one address, and s after the last of them until the next is looked at."""
_SHORTEST = 16  # Characters. At 10 a minute nobody guesses so many.
_ADDRESSES = 1024  # That are remembered.


class Access(Enum):
    """The answer to somebody with a token, as HTTP statuses."""

    WELCOME = 200
    WRONG = 403
    ENOUGH = 429


class TokenGate:
    """Compares tokens in a time that says nothing about them. `clock` counts seconds. Without a token all may come in:
    then nobody but this computer can knock."""

    def __init__(self, token: str | None, clock: Callable[[], float]) -> None:
        self._token, self._clock = token, clock
        self._wrong: OrderedDict[str, tuple[int, float]] = OrderedDict()

    @property
    def asks(self) -> bool:
        """Whether a token is needed."""
        return self._token is not None

    def answer(self, address: str, token: str) -> Access:
        """To somebody at an address. While it must rest not even the right token is looked at, or the rest were
        none."""
        if self._token is None:
            return Access.WELCOME
        now = self._clock()
        count, last = self._wrong.get(address, (0, now))
        if count >= TRIES and now < last + REST:
            return Access.ENOUGH
        if hmac.compare_digest(token.encode(), self._token.encode()):
            self._wrong.pop(address, None)
            return Access.WELCOME
        if token:  # Who brings none has not guessed.
            self._wrong[address] = (count + 1 if now < last + REST else 1, now)
            self._wrong.move_to_end(address)
            while len(self._wrong) > _ADDRESSES:
                self._wrong.popitem(last=False)
        return Access.WRONG


def checked(token: str) -> str:
    """A token that a person chose. Raises ConfigError for one that can be guessed or does not fit into an address."""
    if len(token) < _SHORTEST:
        raise ConfigError(f"the token has {len(token)} characters; it needs {_SHORTEST} or more")
    if not all(c.isascii() and (c.isalnum() or c in "-_.~") for c in token):
        raise ConfigError("the token may have letters, digits and - _ . ~ only: it stands in an address")
    return token
