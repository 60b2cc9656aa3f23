"""Being a hand on a serial line at a terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from allegro_twin.app.config import RunConfig
from allegro_twin.drivers.base.settings import VIRTUAL_PORT
from allegro_twin.drivers.dynamixel.config import DynamixelSettings
from allegro_twin.drivers.polled.config import PolledSettings
from allegro_twin.errors import ConfigError
from allegro_twin.plugins import BACKENDS

_SWITCH = 0.0005
"""s after which the thread that computes physics lets the one that answers have Python."""


def be_servos(configs: Sequence[RunConfig], step: float | None, seconds: float | None, *, more: bool) -> None:
    """Serve the config's hand in real time at a pseudo-terminal in place of its port. `more`: a report or a bus log was
    asked for. Raises ConfigError or LinkError."""
    from allegro_twin.app.rig import Scene, context_of
    from allegro_twin.drivers.base.serve import serve
    from allegro_twin.drivers.base.terminal import Terminal
    from allegro_twin.drivers.can.driver.realtime import ask_short_slice
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console

    config = configs[0]
    settings = config.backend
    assert isinstance(settings, DynamixelSettings | PolledSettings)
    if len(configs) > 1 or more:
        raise ConfigError("a hand on a serial line is served alone, without --report or --wire-log, which are for CAN")
    if settings.port == VIRTUAL_PORT:
        raise ConfigError(f"port {VIRTUAL_PORT} is a line inside one program; give the path that a terminal shall have")
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    hand = BACKENDS.kind(settings.kind).virtual(settings, context_of(config, Scene()), step or config.period)
    who: str = settings.kind
    if isinstance(settings, DynamixelSettings):
        who = "ids " + ", ".join(str(servo.id) for servo in hand.servos)
    terminal, served = Terminal(Path(settings.port)), None
    ask_short_slice()
    sys.setswitchinterval(_SWITCH)
    said = f"{spec.name} at {settings.port}, {who} at {settings.baud} baud; Ctrl-C ends it"
    console.console.print(said, highlight=False, soft_wrap=True)
    try:
        with suppress(KeyboardInterrupt):
            for served in serve(hand, terminal):
                if seconds is not None and served.steps * hand.period >= seconds:
                    break
    finally:
        terminal.close()
    if served is not None:
        console.console.print(served.summary(), highlight=False, soft_wrap=True)
