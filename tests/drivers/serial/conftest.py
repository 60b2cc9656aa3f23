"""What a test leaves open is closed after it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.drivers.serial.rigs import MADE


@pytest.fixture(autouse=True)
def everything_is_closed() -> Iterator[None]:
    yield
    while MADE:
        MADE.pop().close()
