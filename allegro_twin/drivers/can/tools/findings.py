"""Findings of a checkup: each row judges one measurement of a link, as a pure function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.codec import FINGERS, Codec
from allegro_twin.drivers.can.driver.clock import EXCUSED, OFF, steady
from allegro_twin.drivers.can.driver.startup import TRIES
from allegro_twin.drivers.can.link.load import CEILING
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, LinkTimeout
from allegro_twin.safety import Limits
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

BEYOND = 0.15
"""rad outside the model's limits that a real joint may be: found limits differ by as much as its stops give."""
JUMP = 0.1
"""rad between two reports that no joint can do: 33 rad/s at 3 ms; the motors' no-load speed is 9.52 rad/s."""
_LOST = 0.1  # Of all reports: more is no link to control a hand over.
_TEMPERATURE: dict[str, Any] = {field.name: field.default for field in fields(Limits)}


class Finding(NamedTuple):
    """One step of a checkup."""

    name: str
    text: str
    remedy: str = ""
    """What to do about it."""
    broken: type[HandError] | None = None
    """What it is, where the step failed; nothing after it makes sense then."""

    @property
    def ok(self) -> bool:
        return self.broken is None

    @classmethod
    def of(cls, name: str, error: HandError) -> Finding:
        """An error as a finding: what comes after its first semicolon is the way out."""
        text, _, remedy = str(error).partition("; ")
        return cls(name, text, remedy, type(error))


def bus(frames: int, seconds: float, errors: int, bitrate: int, commands: str, who: str) -> Finding:
    """What happened before anything was sent. `commands`: a frame by which somebody else drives this hand; `who`
    reports."""
    rate = f"{frames / seconds:.0f} frames/s" if frames else "silent, as a hand is until it is told to report"
    text = f"{rate}, {errors or 'no'} error frames{f'; {who} reports' if who else ''}"
    if commands:
        return Finding("bus", f"another program commands this hand: {commands}", "stop one of the two", LinkError)
    if errors:
        remedy = (
            f"does every adapter have {bitrate} bit/s? check the wiring and the termination (60 Ω between the wires)"
        )
        return Finding("bus", text, remedy, LinkError)
    return Finding("bus", text)


def identity(codec: Codec, found: m.Information | None, serial: str) -> Finding:
    """Who the hand says it is."""
    if found is None:
        why = "was not told to (`identify: false`)" if codec.identifies else "has no such message"
        return Finding("identity", f"does not answer; fine, for a {codec.version} hand {why}")
    version = f"hardware {found.hardware:#06x}, firmware {found.firmware:#06x}"
    return Finding("identity", f"{version}, {found.side or 'side untold'}, serial {serial or 'untold'}")


def fingers(heard: Sequence[bool], instead: str, motors: bool | None = None) -> Finding:
    """Which fingers report. `instead`: who else does, if none of them; `motors`: whether they are on, says a hand that
    answers but does not report."""
    silent = [name for name, known in zip(FINGERS, heard, strict=True) if not known]
    if not silent:
        return Finding("fingers", "all four report")
    if len(silent) == len(FINGERS):
        if motors is not None and not instead:
            text = f"none reports, though the hand answers that its motors are {'on' if motors else 'off'}"
            if motors:
                return Finding("fingers", text, "check cable, termination and version", LinkTimeout)
            text += f": it was told {TRIES} times to switch them on"
            return Finding("fingers", text, "switch the hand off and on; check its supply", HandFault)
        text = f"none reports{f', but {instead} does' if instead else ''}"
        remedy = "correct `backend.version` or `device`" if instead else "check power, cable, bitrate and version"
        return Finding("fingers", text, remedy, LinkTimeout)
    names = " and ".join(silent)
    return Finding(
        "fingers", f"{names} silent", "switch the hand off and on; then it is the finger's cable", LinkTimeout
    )


def timing(stamps: Sequence[float], seconds: float, period: float, incomplete: int, timeout: float) -> Finding:
    """Rate and jitter of whole hands, from when they came in some seconds, s."""
    gaps = np.diff(np.asarray(stamps))
    if len(gaps) < 10:
        return Finding("reports", f"{len(stamps)} whole hands", "check power, cable and bitrate", LinkTimeout)
    p50, p99, worst = (float(v) for v in (*np.percentile(gaps, (50, 99)), gaps.max()))
    asked = round(seconds / period)
    lost = max(asked - 1 - len(stamps), 0)  # Where the seconds begin and end is chance.
    text = (
        f"{len(stamps) / seconds:.1f} a second; interval p50 {p50 * 1000:.2f}, p99 {p99 * 1000:.2f}, worst "
        f"{worst * 1000:.2f} ms; {lost} of {asked} lost, {incomplete} incomplete"
    )
    often = len(stamps) > (1.0 + OFF) * asked  # Nothing else makes more reports; losses make fewer.
    seldom = incomplete <= EXCUSED * len(stamps) and steady(gaps.tolist()) > (1.0 + OFF) * period
    if often or seldom:
        return Finding("reports", text, f"the config says period: {period:g} s; set what the hand does", ConfigError)
    if lost > _LOST * asked or worst > timeout:
        remedy = "check cable and termination; on a busy computer, `realtime: true`"
        return Finding("reports", text, remedy, LinkError)
    return Finding("reports", text)


def motors(on: bool | None, version: str) -> Finding:
    """Whether the motors are on, by the hand's last word after it was told so; None: it said nothing."""
    if on is None:
        return Finding("motors", f"a {version} hand has not said whether they are on")
    if not on:
        text = f"the hand was told {TRIES} times to switch them on, and says that they are off"
        return Finding("motors", text, "switch the hand off and on; check its supply", HandFault)
    return Finding("motors", "on, says the hand")


def limp(why: str) -> Finding:
    """Whether the hand was left limp. `why`: what speaks against it."""
    if why:
        text = f"the hand has not confirmed that it is limp ({why})"
        return Finding("limp", text, "cut its power", HandFault)
    return Finding("limp", "the hand was left limp, and has confirmed it")


def temperature(celsius: Vector, version: str) -> Finding:
    """Motor temperatures, (16,), °C."""
    if np.isnan(celsius).all():
        return Finding("temperature", f"a {version} hand did not report any; the guard cannot look at it")
    low, high = float(np.nanmin(celsius)), float(np.nanmax(celsius))
    text = f"{low:.0f} to {high:.0f} °C"
    if high >= _TEMPERATURE["hot"]:
        return Finding("temperature", text, "switch the hand off and let it cool down", HandFault)
    return Finding(
        "temperature", text + (", warm: the guard lets less torque through" if high >= _TEMPERATURE["warm"] else "")
    )


def joints(positions: Array, spec: HandSpec, version: str) -> Finding:
    """Whether joint positions, (k, 16), rad, can be those of this hand at rest."""
    last = positions[-1]
    remedy = (
        "encoder_offset and encoder_direction must be this very hand's: name its file with `hand: {serial: …}`"
        if version in ("v1", "v2", "v3")
        else "move the joint by hand; if it still reads so, switch off and on, then `allegro-twin calibrate limits`"
    )
    if (last == last[0]).all():
        return Finding("joints", f"all read {last[0]:.3f} rad", "switch the hand off and on", LinkError)
    excess = np.maximum(spec.lower - BEYOND - last, last - spec.upper - BEYOND)
    beyond = [
        f"{spec.joint_labels[k]} {last[k]:+.2f} rad (range {spec.lower[k]:+.2f} to {spec.upper[k]:+.2f})"
        for k in np.flatnonzero(excess > 0.0)
    ]
    if beyond:
        return Finding("joints", f"out of range: {', '.join(beyond)}", remedy, ConfigError)
    jumps = np.abs(np.diff(positions, axis=0)).max(axis=0) if len(positions) > 1 else np.zeros(len(last))
    if jumps.max() > JUMP:
        worst = int(np.argmax(jumps))
        text = f"{spec.joint_labels[worst]} jumps by {jumps[worst]:.2f} rad between two reports"
        return Finding("joints", text, remedy, ConfigError)
    return Finding("joints", f"all inside their ranges; they moved {np.ptp(positions, axis=0).max():.4f} rad at most")


def side(reported: str | None, spec: HandSpec) -> Finding:
    """Which side it is. The ranges of both sides are the same, so only the hand itself can tell."""
    if reported is not None:
        return Finding("side", f"{reported}, says the hand")
    return Finding("side", f"cannot be told from here; make sure that it is a {spec.side} hand, as the config says")


def load(share: float, measured: float, bitrate: int, unknown: int, others: str) -> Finding:
    """How full the bus is: computed for this hand alone, measured for everybody."""
    text = f"{measured:.0%} of {bitrate / 1e6:g} Mbit/s measured; this hand takes {share:.0%} at worst"
    text += f"; {others} reports too" if others else ""
    text += f"; {unknown} frames with unknown identifiers" if unknown else ""
    if measured > CEILING:
        return Finding("load", text, "use a longer period, or a bus for each hand", LinkError)
    return Finding("load", text)
