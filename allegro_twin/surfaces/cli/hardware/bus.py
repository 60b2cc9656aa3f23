"""Commands for buses: check a link, listen to a bus, serve a virtual hand."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.app.config import RunConfig
    from allegro_twin.app.rig import SimulatedScene
    from allegro_twin.drivers.base.pacing import Served
    from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
    from allegro_twin.grasping.verdict import TrialReport

_SWITCH = 0.0005
"""s after which the physics thread lets the answering thread have Python."""


def check(
    config: Annotated[str, typer.Argument(help="Config with a `can` backend.", autocompletion=completion.configs)],
    hand: OtherHand = None,
) -> None:
    """Test the link to a hand step by step, at zero torque."""
    from allegro_twin.app.config import load_config
    from allegro_twin.app.serve_can import checkup_of
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.cli.hardware import bus_tables

    walk = checkup_of(on_hand(load_config(config), hand)).walk()
    found, table = None, bus_tables.checkup(config)
    with closing(walk), console.growing(table) as refresh:
        for found in walk:
            bus_tables.add(table, found)
            refresh()
    if found is not None and found.broken is not None:
        raise found.broken("; ".join(filter(None, (f"{found.name}: {found.text}", found.remedy))))


def sniff(
    config: Annotated[
        str | None,
        typer.Argument(help="Config with a `can` backend; or use the options.", autocompletion=completion.configs),
    ] = None,
    interface: Annotated[str | None, typer.Option(help="Adapter, by its name in python-can.")] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the adapter.")] = None,
    bitrate: Annotated[int | None, typer.Option(help="Bit rate, bit/s.")] = None,
    option: Annotated[
        list[str] | None, typer.Option(help="KEY=VALUE for the interface of python-can, e.g. host=127.0.0.1.")
    ] = None,
    version: Annotated[
        str | None, typer.Option(help="Version of the hand, v1 to v5plus; default: the config's, or a guess.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Duration, s; default: until Ctrl-C.", callback=options.positive)
    ] = None,
    lines: Annotated[bool, typer.Option(help="Print one line for each frame, not a table.")] = False,
) -> None:
    """Listen to a CAN bus and decode its frames; sends nothing.

    A serial adapter serves one program at a time."""
    from allegro_twin.app.bus_listener import ears_of
    from allegro_twin.drivers.can.tools.sniff import listened
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hardware import bus_tables

    given = {"interface": interface, "channel": channel, "bitrate": bitrate, "version": version}
    bus, sniffer = ears_of(config, {key: value for key, value in given.items() if value is not None}, option or [])
    try:
        if lines or not sys.stdout.isatty():
            bus_tables.lines(sniffer, listened(bus, seconds))
        else:
            bus_tables.live(sniffer, listened(bus, seconds), str(bus.channel_info))
    except KeyboardInterrupt:
        pass
    finally:
        bus.shutdown()
    console.errors.print(f"{sniffer.frames} frames, {sniffer.errors} error frames; {sniffer.title()}", highlight=False)


def firmware(
    configs: Annotated[
        list[str],
        typer.Argument(
            help="Config of a hand on a bus or a serial port; several CAN hands share one bus.",
            autocompletion=completion.configs,
        ),
    ],
    hand: OtherHand = None,
    seconds: Annotated[
        float | None, typer.Option(help="Duration, s; default: until Ctrl-C.", callback=options.positive)
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(
            help="Physics time between two polls of the bus, s; default: the config's period.",
            callback=options.positive,
        ),
    ] = None,
    pose: Annotated[
        str | None, typer.Option(help="Stand it in this pose, alone: up, side, palm-up, palm-down.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            help="Write the verdict on a scenario to this .json; replaces it.", callback=options.file(".json")
        ),
    ] = None,
    wire_log: Annotated[
        Path | None,
        typer.Option(
            help="Log every frame to this .blf, .log or .asc; replaces it.",
            callback=options.file(".blf", ".log", ".asc"),
        ),
    ] = None,
) -> None:
    """Serve a virtual hand on a bus or serial port, for any driver."""
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
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.twin.identify import find_pose
    from allegro_twin.twin.identify.record_excitation import served_pose

    if hand is not None and len(configs) > 1:
        raise ConfigError(f"--hand is for one hand; these are {len(configs)} configs: say it in their `hand` blocks")
    loaded = [on_hand(load_config(name), hand) for name in configs]
    if pose is not None:
        loaded = [served_pose(each, find_pose(pose, each.hand.side)) for each in loaded]
    settings = loaded[0].backend
    if isinstance(settings, DynamixelSettings | PolledSettings):
        return _serve_serial(loaded, step, seconds, more=bool(report or wire_log))
    if not isinstance(settings, CanSettings):
        raise ConfigError(f"{configs[0]} has backend {settings.kind}; a hand on a bus needs `backend: {{kind: can}}`")
    scenes: list[SimulatedScene] = []
    hands = virtual_hands(loaded, step=step, scenes=scenes, restart=True)
    log = None if wire_log is None else WireLog(wire_log, Path(settings.channel).name)
    bus = far_end(settings) if log is None else LoggedBus(far_end(settings), log)
    realtime.ask(settings.realtime)
    names = ", ".join(f"{c.hand.side} {fw.codec.version}" for c, fw in zip(loaded, hands.firmwares, strict=True))
    console.say(f"{names} hand on {bus.channel_info}; Ctrl-C ends it")
    try:
        served, verdicts = _serve_can(serve(hands, bus, local=local(settings)), hands, scenes, seconds)
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


def _serve_can(
    serving: Iterator[Served], hands: VirtualHands, scenes: list[SimulatedScene], seconds: float | None
) -> tuple[Served | None, dict[str, TrialReport]]:
    """Serve until `seconds` are over or Ctrl-C. Returns statistics, and the verdicts on scenarios."""
    from allegro_twin.app.serve_can import judged
    from allegro_twin.surfaces.cli import console

    served, verdicts = None, dict[str, "TrialReport"]()
    with suppress(KeyboardInterrupt):
        for served in serving:
            for scene, hand in zip(scenes, hands.firmwares, strict=True):
                if (verdict := judged(scene, hand)) is not None:
                    spec = hand.backend.spec
                    verdicts[spec.name] = verdict
                    console.console.print(console.phases(spec.name, verdict, spec.thermal))
            if seconds is not None and served.steps * hands.period >= seconds:
                break
    return served, verdicts


def _serve_serial(configs: Sequence[RunConfig], step: float | None, seconds: float | None, *, more: bool) -> None:
    """Serve the config's hand in real time at a pseudo-terminal in place of its port. `more`: a report or a bus log is
    requested. Raises ConfigError or LinkError."""
    from allegro_twin.app.rig import SimulatedScene, context_of
    from allegro_twin.drivers.base.host_settings import VIRTUAL_PORT
    from allegro_twin.drivers.base.serve import serve
    from allegro_twin.drivers.base.terminal import Terminal
    from allegro_twin.drivers.can.driver.realtime import ask_short_slice
    from allegro_twin.drivers.dynamixel.config import DynamixelSettings
    from allegro_twin.drivers.polled.config import PolledSettings
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.plugins import BACKENDS
    from allegro_twin.surfaces.cli import console

    config = configs[0]
    settings = config.backend
    assert isinstance(settings, DynamixelSettings | PolledSettings)
    if len(configs) > 1 or more:
        raise ConfigError("a hand on a serial line is served alone, without --report or --wire-log, which are for CAN")
    if settings.port == VIRTUAL_PORT:
        raise ConfigError(f"port {VIRTUAL_PORT} is a line inside one program; give the path that a terminal shall have")
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    hand = BACKENDS.kind(settings.kind).virtual(settings, context_of(config, SimulatedScene()), step or config.period)
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
