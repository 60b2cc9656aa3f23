"""What `mirror` does and prints: run a hand with its mirror, record and draw it, tables of results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rich.table import Table

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file

if TYPE_CHECKING:
    from allegro_twin.app.config import RunConfig
    from allegro_twin.app.rig import Rig
    from allegro_twin.spec import HandSpec
    from allegro_twin.twin.mirror.mirror import Mirror
    from allegro_twin.twin.mirror.on_recording import MirrorResult
    from allegro_twin.types import Sample, Vector


class MirrorOutputs(NamedTuple):
    """Thresholds, stop events and outputs of a run with a mirror."""

    free: Path | None = None
    stop: tuple[str, ...] = ()
    record: Path | None = None
    rrd: Path | None = None
    live: str | None = None
    """`native` or `web`."""
    gravity: Vector | None = None
    """Gravity in the palm frame, m/s², if the hand does not report it."""


def run_with_mirror(
    config: RunConfig,
    hand: str,
    outputs: MirrorOutputs,
    advance: Callable[[float], None],
    report: Callable[[str], None],
) -> MirrorResult:
    """Run a config's hand with its mirror. Raises HandError; HandFault for an event that stops it."""
    from allegro_twin.app.rig import assemble
    from allegro_twin.drivers.can.config import CanSettings
    from allegro_twin.drivers.dynamixel.config import DynamixelSettings
    from allegro_twin.loop import run, to_the_end, until
    from allegro_twin.twin.mirror.contact_detection import find_contacts
    from allegro_twin.twin.mirror.on_recording import MirrorResult

    if not isinstance(config.backend, CanSettings | DynamixelSettings):
        raise ConfigError(
            f"a {config.backend.kind} hand is its own twin: `mirror` is for hands on a bus or a line, and recordings"
        )
    rig = assemble(config)
    each = _mirror(config, rig, hand, outputs)
    rows = []
    with closing(rig.backend), ExitStack() as stack:
        samples = each.watch(to_the_end(run(rig.backend, rig.controller)))
        if rig.seconds is not None:
            samples = until(rig.seconds, samples)
        samples = _record(samples, config, rig, each, outputs)
        samples = _draw(samples, rig, each, outputs, stack, report)
        for sample in samples:
            latest = each.columns()
            off = sample.state.position - latest["predicted"]
            touched = latest["event"][: len(rig.spec.fingers)] > 0.0
            rows.append((sample.state.t, latest["disturbance"], off, each.contact_thresholds, touched))
            advance(sample.state.t)
    t, disturbance, off, above, touched = (np.array(column) for column in zip(*rows[1:], strict=True))
    touches = tuple(find_contacts(t, touched, disturbance, above, rig.spec))
    return MirrorResult(t, disturbance, off, above, touches, each.faults, each.unchecked_faults)


def _mirror(config: RunConfig, rig: Rig, hand: str, outputs: MirrorOutputs) -> Mirror:
    """Raises HandError."""
    from allegro_twin.drivers.can.config import CanSettings
    from allegro_twin.drivers.can.opening import codec_of
    from allegro_twin.twin.mirror.factory import make_loop_mirror, make_mirror
    from allegro_twin.twin.mirror.fault_detection import Thresholds
    from allegro_twin.twin.mirror.on_recording import free_motion_thresholds

    gravity = _gravity(rig, outputs)
    file = hand or rig.spec.serial
    calm = Thresholds.default(rig.spec) if outputs.free is None else free_motion_thresholds(outputs.free, file, gravity)
    if not isinstance(config.backend, CanSettings):
        return make_loop_mirror(rig.spec, config.period, calm, outputs.stop, gravity)
    codec = codec_of(config.backend, config.hand)
    return make_mirror(
        rig.spec, file, codec.version, codec.calibration, config.period, calm, outputs.stop, outputs.gravity
    )


def _gravity(rig: Rig, outputs: MirrorOutputs) -> Vector | None:
    from allegro_twin.twin.mirror.on_rig import palm_gravity

    return palm_gravity(rig) if outputs.gravity is None else outputs.gravity


def _record(
    samples: Iterator[Sample], config: RunConfig, rig: Rig, mirror: Mirror, outputs: MirrorOutputs
) -> Iterator[Sample]:
    from allegro_twin.recording.recorder import record

    if outputs.record is None:
        return samples
    meta: dict[str, object] = {"calibration": dict(rig.device.calibration), "config": config.model_dump(mode="json")}
    gravity = _gravity(rig, outputs)
    meta |= {} if gravity is None else {"gravity": gravity.tolist()}
    meta |= rig.sim.meta() if rig.sim is not None else {}
    return record(samples, outputs.record, rig.spec, config.period, meta=meta, extras=mirror.columns)


def _draw(
    samples: Iterator[Sample],
    rig: Rig,
    mirror: Mirror,
    outputs: MirrorOutputs,
    stack: ExitStack,
    report: Callable[[str], None],
) -> Iterator[Sample]:
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.loop import paced

    if outputs.rrd is None and outputs.live is None:
        return samples
    viewer_of, _ = rerun_stage()
    from allegro_twin.twin.mirror.rerun_view import RATE, draw_mirror, mirror_scenery

    health = getattr(rig.driver, "health", None)
    if outputs.rrd is not None:
        temporary = stack.enter_context(atomic_file(outputs.rrd))
        viewer = viewer_of(rig.spec, mirror_scenery(rig.spec), rate=RATE)
        stack.callback(viewer.close)
        samples = draw_mirror(samples, mirror, viewer.to_file(temporary), health)
    if outputs.live is not None:
        viewer = viewer_of(rig.spec, mirror_scenery(rig.spec), rate=RATE, live=True)
        stack.callback(viewer.close)
        if outputs.live == "web":
            report(f"Open {viewer.serve()}")
        else:
            viewer.spawn()
        samples = draw_mirror(paced(samples) if not rig.live else samples, mirror, viewer, health)
    return samples


def parse_gravity(text: str) -> Vector:
    """Parse `0,0,-9.81`, m/s². Raises ConfigError."""
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise ConfigError(f"--gravity {text}: three numbers with commas between, as 0,0,-9.81") from error
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ConfigError(f"--gravity {text}: three numbers with commas between, as 0,0,-9.81")
    return values


def table(found: MirrorResult, joints: tuple[str, ...]) -> Table:
    """One row for each joint: prediction error, disturbance, and the threshold of a touch."""
    made = Table(title=f"{found.t[-1] - found.t[0]:.1f} s beside the model")
    made.add_column("joint")
    for head in ("off by, rms\nµrad", "pushed, rms\nmN·m", "largest\nmN·m", "a touch from\nmN·m"):
        made.add_column(head, justify="right")
    chosen = found.t > found.t[0] + 1.0
    off, push = (np.sqrt(np.nanmean(np.square(each[chosen]), axis=0)) for each in (found.residual, found.disturbance))
    largest = np.nanmax(np.abs(found.disturbance[chosen]), axis=0)
    least = found.contact_thresholds[chosen].min(axis=0)
    for joint, name in enumerate(joints):
        row = (1e6 * off[joint], 1e3 * push[joint], 1e3 * largest[joint], 1e3 * least[joint])
        made.add_row(name, *(f"{value:.1f}" for value in row))
    return made


def missing_checks(found: MirrorResult, free: Path | None) -> str:
    """The faults that the mirror cannot detect without a long enough --free; empty if it detects all."""
    from allegro_twin.twin.mirror.fault_detection import ENOUGH

    if not found.unchecked_faults:
        return ""
    why = "there is no --free" if free is None else f"{free} is too short"
    *names, last = found.unchecked_faults
    return (
        f"{', '.join(names)} and {last} are not looked for, because {why}: record {ENOUGH:g} s or more of motion that "
        "touches nothing, as `allegro-twin excite … --seconds 24`, and give it with --free"
    )


def lines(found: MirrorResult, spec: HandSpec) -> list[str]:
    """The touches and the faults, one line each."""
    from allegro_twin.twin.mirror.faults import fault_text, report_text
    from allegro_twin.twin.mirror.on_recording import possible_cause

    causes = [possible_cause(each, found.faults, spec) for each in found.contacts]
    said = [
        f"{each.finger} is touched from {each.begin:.3f} to {each.end:.3f} s, by up to {1000 * each.torque:.0f} mN·m"
        + (f", on the link of {spec.joint_labels[each.joint]} or further out" if each.joint >= 0 else "")
        + ("" if cause is None else f"; this may be because {fault_text(cause.fault, spec)}")
        for each, cause in zip(found.contacts, causes, strict=True)
    ]
    said = said or ["Nothing touched it."]
    return said + [f"Something is wrong: {report_text(each, spec)}." for each in found.faults]
