"""Start of a session with a hand: silence it, ask for its identity, start its reports, switch its motors on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.detect import reporting
from allegro_twin.drivers.can.codec.frames import Frame
from allegro_twin.drivers.can.codec.messages import Message, Topic
from allegro_twin.drivers.can.codec.v5 import parse_serial
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.driver.listener import refuse
from allegro_twin.drivers.can.link.shared_bus import BusPort, Stamped
from allegro_twin.errors import ConfigError, LinkError, LinkTimeout, ProtocolError
from allegro_twin.spec import HandSpec, Side

GAP = 0.001
"""Between two frames of the sequence, s; the manufacturer's drivers leave 10 µs (v1–v3 L) to 10 ms (C)."""
QUIET = 0.02
"""A hand that was told to be silent is so after this long, s."""
TRIES, ANSWER = 3, 0.1
"""How often a hand is asked, and s that it has each time; more where the settings' `timeout` says that it is late."""
_GENERATION = {"v4": 4, "v5": 5, "v5plus": 5}
"""High byte of the hardware version. R4 AllegroHandDrv.cpp:278 asks for 4."""


def begin(
    port: BusPort,
    codec: Codec,
    settings: CanHostSettings,
    spec: HandSpec,
    limp: Sequence[Frame],
    serving: Callable[[], None] = lambda: None,
) -> list[Stamped]:
    """Bring the hand from any state to reporting, limp, with its motors on; `serving` is called before they go on.

    Returns the frames that came meanwhile and belong to the session. Raises LinkError, LinkTimeout, ConfigError or
    HandFault.
    """
    if not port.send(limp):
        raise LinkError(f"{port.link.name} takes no frames; is the hand powered and on this bus?")
    _drain(port)
    if settings.identify and codec.identifies:
        identify(port, codec, spec, settings.timeout)
    serving()
    return set_up(port, codec, settings)


def set_up(port: BusPort, codec: Codec, settings: CanHostSettings) -> list[Stamped]:
    """Tell the hand to report, and to switch its motors on at zero torque; any of these frames may be lost. Returns the
    frames that came meanwhile. Raises LinkError."""
    words = codec.opening(settings.period, settings.imu_period, settings.temperature_period)
    return _say(port, [*map(codec.encode, words), *codec.torques.zero.frames, codec.encode(m.ServoOn())])


def ask(port: BusPort, codec: Codec, topic: Topic, kind: type[Message], timeout: float) -> Message | None:
    """Ask a hand for something, which may be `timeout` s late; None when it does not answer."""
    for _ in range(TRIES):
        port.send([codec.encode(m.Request(topic))])
        deadline = port.link.now() + max(timeout, ANSWER)
        while port.link.now() < deadline:
            stamped = port.receive(max(deadline - port.link.now(), 0.0))
            if stamped is None:
                break
            try:
                message = codec.decode(stamped.frame)
            except ProtocolError:
                continue  # Noise is no answer; the session counts it later.
            if isinstance(message, kind):
                return message
    return None


def _drain(port: BusPort) -> None:
    """Let what is under way arrive, and forget it."""
    deadline = port.link.now() + 5 * QUIET
    seen: list[Frame] = []
    while port.link.now() < deadline:
        stamped = port.receive(QUIET)
        if stamped is None:
            return
        seen.append(stamped.frame)


def identify(port: BusPort, codec: Codec, spec: HandSpec, timeout: float) -> tuple[m.Information, Side | None]:
    """Who the hand, which may be `timeout` s late, says it is, and its side where it tells.

    Raises LinkTimeout when nobody answers, ConfigError when it is another hand than the config says, HandFault when it
    must not be driven.
    """
    found = ask(port, codec, Topic.INFORMATION, m.Information, timeout)
    if found is None:
        raise LinkTimeout(
            f"no {codec.version} hand answers on {port.link.name}{_instead(port)}; check power, cable, bitrate, "
            "version and device, or set `identify: false` for a hand that does not answer"
        )
    assert isinstance(found, m.Information)
    if why := mismatch(found, codec, spec.side):
        raise ConfigError(why)
    side = found.side
    if side is None and isinstance(serial := ask(port, codec, Topic.SERIAL, m.Serial, timeout), m.Serial):
        side = parse_serial(serial.text)[1]
        if why := mismatch(serial, codec, spec.side):
            raise ConfigError(why)
    if found.bits is not None:
        refuse(found.bits)  # Before the motors go on: a hand that is still hot stays limp.
    return found, side


def mismatch(answer: m.Information | m.Serial, codec: Codec, side: str) -> str:
    """Why a hand that says this of itself is not the one of a config, which has this side; empty where it may be."""
    generation = _GENERATION.get(codec.version)
    if isinstance(answer, m.Information):
        its = answer.side
        if generation is not None and answer.hardware >> 8 != generation:
            return f"the hand says hardware {answer.hardware:#06x}, which is no {codec.version} hand; correct `version`"
    else:
        if generation != 5:  # A serial of others tells neither.
            return ""
        version, its = parse_serial(answer.text)
        if version is not None and version != codec.version:
            return f"serial {answer.text} is a {version} hand, not {codec.version}; correct `version`"
    if its is None or its == side:
        return ""
    return f"this is a {its} hand; the config says {side}: correct `hand: {{side: …}}`"


def _instead(port: BusPort) -> str:
    """Who else reports on this bus."""
    frames: list[Frame] = []
    while (stamped := port.receive(QUIET)) is not None and len(frames) < 100:
        frames.append(stamped.frame)
    others = reporting(frames)
    return f" (but {others} reports)" if others else ""


def _say(port: BusPort, frames: Iterable[Frame]) -> list[Stamped]:
    """Send with gaps; what came in them."""
    heard = []
    for frame in frames:
        if not port.send([frame]):
            raise LinkError(f"{port.link.name} takes no frames; is the hand powered and on this bus?")
        if (stamped := port.receive(GAP)) is not None:
            heard.append(stamped)
    return heard
