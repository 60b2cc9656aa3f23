"""Commands for CAN buses: be a hand, look at a link, listen to a bus."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.app.rig import Scene
    from allegro_twin.drivers.can.virtual.serve import Served
    from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
    from allegro_twin.grasping.verdict import TrialReport


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    app.command()(firmware)
    app.command()(check)
    app.command()(sniff)


def check(
    config: Annotated[str, typer.Argument(help="A config with a `can` backend.", autocompletion=complete.configs)],
    hand: OtherHand = None,
) -> None:
    """Walk the link to a hand step by step, at zero torque, and stop at the first thing that is broken."""
    from rich.live import Live

    from allegro_twin.app.config import load_config
    from allegro_twin.app.serve_can import checkup_of
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand import monitor
    from allegro_twin.surfaces.cli.performers import on_hand

    walk = checkup_of(on_hand(load_config(config), hand)).walk()
    found, table = None, monitor.checkup(config)
    with closing(walk), Live(table, console=console.console, auto_refresh=False) as live:
        for found in walk:
            monitor.add(table, found)
            live.refresh()
    if found is not None and found.broken is not None:
        raise found.broken("; ".join(filter(None, (f"{found.name}: {found.text}", found.remedy))))


def sniff(
    config: Annotated[
        str | None,
        typer.Argument(help="A config with a `can` backend; or say it with options.", autocompletion=complete.configs),
    ] = None,
    interface: Annotated[str | None, typer.Option(help="python-can's name of the adapter.")] = None,
    channel: Annotated[str | None, typer.Option(help="Of the adapter.")] = None,
    bitrate: Annotated[int | None, typer.Option(help="bit/s.")] = None,
    option: Annotated[
        list[str] | None, typer.Option(help="KEY=VALUE for python-can's interface, e.g. host=127.0.0.1.")
    ] = None,
    version: Annotated[str | None, typer.Option(help="v1 to v5plus; default: the config's, or a guess.")] = None,
    seconds: Annotated[
        float | None, typer.Option(help="How long; default: until Ctrl-C.", callback=options.positive)
    ] = None,
    lines: Annotated[bool, typer.Option(help="One line a frame, as in a pipe, instead of a table.")] = False,
) -> None:
    """Listen to any bus and say what the frames mean. Sends nothing. A serial adapter serves one program at a time."""
    from allegro_twin.app.bus_listener import ears_of
    from allegro_twin.drivers.can.tools.sniff import listened
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand import monitor

    given = {"interface": interface, "channel": channel, "bitrate": bitrate, "version": version}
    bus, sniffer = ears_of(config, {key: value for key, value in given.items() if value is not None}, option or [])
    try:
        if lines or not console.console.is_terminal:
            monitor.lines(sniffer, listened(bus, seconds))
        else:
            monitor.live(sniffer, listened(bus, seconds), str(bus.channel_info))
    except KeyboardInterrupt:
        pass
    finally:
        bus.shutdown()
    console.errors.print(f"{sniffer.frames} frames, {sniffer.errors} error frames; {sniffer.title()}", highlight=False)


def firmware(
    configs: Annotated[
        list[str],
        typer.Argument(help="A config with a `can` backend; several share one bus.", autocompletion=complete.configs),
    ],
    hand: OtherHand = None,
    seconds: Annotated[
        float | None, typer.Option(help="How long; default: until Ctrl-C.", callback=options.positive)
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(
            help="s of physics between two looks at the bus; default: the config's period.", callback=options.positive
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="With a scenario: where the verdict goes (JSON).", callback=options.file(".json")),
    ] = None,
    wire_log: Annotated[
        Path | None,
        typer.Option(help="Log every frame to this .blf, .log or .asc.", callback=options.file(".blf", ".log", ".asc")),
    ] = None,
) -> None:
    """Be a hand: physics behind the real protocol, in real time, for any driver on the config's bus or port."""
    from allegro_twin.app.config import load_config
    from allegro_twin.app.serve_can import far_end, local, virtual_hands
    from allegro_twin.drivers.can.config import CanSettings
    from allegro_twin.drivers.can.driver import realtime
    from allegro_twin.drivers.can.tools.log import LoggedBus, WireLog
    from allegro_twin.drivers.can.virtual.serve import serve
    from allegro_twin.drivers.dynamixel.config import DynamixelSettings
    from allegro_twin.drivers.polled.config import PolledSettings
    from allegro_twin.grasping.evaluation.rejudge import write_reports
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand.servos import be_servos
    from allegro_twin.surfaces.cli.performers import on_hand

    if hand is not None and len(configs) > 1:
        raise ConfigError(f"--hand is for one hand; these are {len(configs)} configs: say it in their `hand` blocks")
    loaded = [on_hand(load_config(name), hand) for name in configs]
    settings = loaded[0].backend
    if isinstance(settings, DynamixelSettings | PolledSettings):
        return be_servos(loaded, step, seconds, more=bool(report or wire_log))
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"{configs[0]} has backend {settings.kind}; a hand on a bus needs `backend: {{kind: can}}`")
    scenes: list[Scene] = []
    hands = virtual_hands(loaded, step=step, scenes=scenes, restart=True)
    log = None if wire_log is None else WireLog(wire_log, Path(settings.channel).name)
    bus = far_end(settings) if log is None else LoggedBus(far_end(settings), log)
    realtime.ask(settings.realtime)
    names = ", ".join(f"{c.hand.side} {fw.codec.version}" for c, fw in zip(loaded, hands.firmwares, strict=True))
    console.console.print(f"{names} hand on {bus.channel_info}; Ctrl-C ends it", highlight=False, soft_wrap=True)
    try:
        served, verdicts = _be(serve(hands, bus, local=local(settings)), hands, scenes, seconds)
    finally:
        bus.shutdown()
        hands.close()
        if log is not None:
            log.close()
    if served is not None:
        console.console.print(served.summary(), highlight=False, soft_wrap=True)
    if report is not None:
        write_reports(report, verdicts)
    return None


def _be(
    serving: Iterator[Served], hands: VirtualHands, scenes: list[Scene], seconds: float | None
) -> tuple[Served | None, dict[str, TrialReport]]:
    """Serve until the time is over or Ctrl-C; what happened, and the verdicts on scenarios."""
    from allegro_twin.app.serve_can import judged
    from allegro_twin.surfaces.cli import console

    served, verdicts = None, dict[str, "TrialReport"]()
    with suppress(KeyboardInterrupt):
        for served in serving:
            for scene, hand in zip(scenes, hands.firmwares, strict=True):
                if (verdict := judged(scene, hand)) is not None:
                    verdicts[hand.backend.spec.name] = verdict
                    console.console.print(console.phases(hand.backend.spec.name, verdict))
            if seconds is not None and served.ticks * hands.step >= seconds:
                break
    return served, verdicts
