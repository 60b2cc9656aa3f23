"""Commands for CAN buses: be a hand, look at a link, listen to a bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    app.command()(firmware)


def firmware(
    configs: Annotated[list[str], typer.Argument(help="A config with a `can` backend; several share one bus.")],
    seconds: Annotated[float | None, typer.Option(help="How long; default: until Ctrl-C.")] = None,
    step: Annotated[
        float | None, typer.Option(help="s of physics between two looks at the bus; default: the config's period.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="With a scenario: where the verdict goes (JSON).")] = None,
) -> None:
    """Be a hand: physics behind the real protocol, in real time, for any driver on the config's bus."""
    from allegro_twin.build.served import far_end, judged, virtual_hands
    from allegro_twin.build.wired import Scene
    from allegro_twin.cli import console
    from allegro_twin.config import CanSettings, load_config
    from allegro_twin.session import write_reports
    from allegro_twin.wire import realtime
    from allegro_twin.wire.serve import serve

    loaded = [load_config(name) for name in configs]
    settings = loaded[0].backend
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"{configs[0]} has backend {settings.kind}; a hand on a bus needs `backend: {{kind: can}}`")
    scenes: list[Scene] = []
    hands = virtual_hands(loaded, step=step, scenes=scenes, restart=True)
    bus = far_end(settings)
    if settings.realtime:
        realtime.ask()
    names = ", ".join(f"{c.hand.side} {fw.codec.version}" for c, fw in zip(loaded, hands.firmwares, strict=True))
    console.console.print(f"{names} hand on {bus.channel_info}; Ctrl-C ends it", highlight=False, soft_wrap=True)
    served, verdicts = None, {}
    try:
        for served in serve(hands, bus):
            for scene, hand in zip(scenes, hands.firmwares, strict=True):
                if (verdict := judged(scene, hand)) is not None:
                    verdicts[hand.backend.spec.name] = verdict
                    console.console.print(console.phases(hand.backend.spec.name, verdict))
            if seconds is not None and served.ticks * hands.step >= seconds:
                break
    except KeyboardInterrupt:
        pass
    finally:
        bus.shutdown()
        hands.close()
    if served is not None:
        console.console.print(
            f"{served.ticks} steps, {served.late} late, {served.lost} left out; {served.heard} frames heard, "
            f"{served.said} said", highlight=False, soft_wrap=True,
        )  # fmt: skip
    if report is not None:
        write_reports(report, verdicts)
