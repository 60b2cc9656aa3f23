"""What `allegro-twin mirror` does and shows, apart from the command line."""

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


class Wanted(NamedTuple):
    """What is to become of a run."""

    free: Path | None = None
    stop: tuple[str, ...] = ()
    record: Path | None = None
    rrd: Path | None = None
    live: str | None = None
    """`native` or `web`."""
    gravity: Vector | None = None
    """In the palm frame, m/s², where the hand does not report it."""


def live(
    config: RunConfig, hand: str, wanted: Wanted, advance: Callable[[float], None], tell: Callable[[str], None]
) -> MirrorResult:
    """Run a config's hand with its mirror beside it. Raises HandError; HandFault for what is to stop it."""
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
    each = _mirror(config, rig, hand, wanted)
    rows = []
    with closing(rig.backend), ExitStack() as stack:
        samples = each.watch(to_the_end(run(rig.backend, rig.controller)))
        if rig.seconds is not None:
            samples = until(rig.seconds, samples)
        samples = _kept(samples, config, rig, each, wanted)
        samples = _drawn(samples, rig, each, wanted, stack, tell)
        for sample in samples:
            latest = each.columns()
            off = sample.state.position - latest["predicted"]
            rows.append((sample.state.t, latest["disturbance"], off, each.contact_thresholds))
            advance(sample.state.t)
    t, disturbance, off, above = (np.array(column) for column in zip(*rows[1:], strict=True))
    touches = tuple(find_contacts(t, disturbance, above, rig.spec))
    return MirrorResult(t, disturbance, off, above, touches, each.fault, each.unchecked_faults)


def _mirror(config: RunConfig, rig: Rig, hand: str, wanted: Wanted) -> Mirror:
    """Raises HandError."""
    from allegro_twin.drivers.can.config import CanSettings
    from allegro_twin.drivers.can.opening import codec_of
    from allegro_twin.twin.mirror.factory import make_loop_mirror, make_mirror
    from allegro_twin.twin.mirror.fault_detection import Thresholds
    from allegro_twin.twin.mirror.on_recording import free_motion_thresholds

    gravity = _down(rig, wanted)
    file = hand or rig.spec.serial
    calm = Thresholds.default(rig.spec) if wanted.free is None else free_motion_thresholds(wanted.free, file, gravity)
    if not isinstance(config.backend, CanSettings):
        return make_loop_mirror(rig.spec, config.period, calm, wanted.stop, gravity)
    codec = codec_of(config.backend, config.hand)
    return make_mirror(
        rig.spec, file, codec.version, codec.calibration, config.period, calm, wanted.stop, wanted.gravity
    )


def _down(rig: Rig, wanted: Wanted) -> Vector | None:
    from allegro_twin.twin.mirror.on_rig import palm_gravity

    return palm_gravity(rig) if wanted.gravity is None else wanted.gravity


def _kept(samples: Iterator[Sample], config: RunConfig, rig: Rig, mirror: Mirror, wanted: Wanted) -> Iterator[Sample]:
    from allegro_twin.recording.recorder import record

    if wanted.record is None:
        return samples
    meta: dict[str, object] = {"calibration": dict(rig.device.calibration), "config": config.model_dump(mode="json")}
    gravity = _down(rig, wanted)
    meta |= {} if gravity is None else {"gravity": gravity.tolist()}
    meta |= rig.sim.meta() if rig.sim is not None else {}
    return record(samples, wanted.record, rig.spec, config.period, meta=meta, extras=mirror.columns)


def _drawn(
    samples: Iterator[Sample], rig: Rig, mirror: Mirror, wanted: Wanted, stack: ExitStack, tell: Callable[[str], None]
) -> Iterator[Sample]:
    from allegro_twin.app.session import rerun_stage
    from allegro_twin.loop import paced

    if wanted.rrd is None and wanted.live is None:
        return samples
    viewer_of, _ = rerun_stage()
    from allegro_twin.twin.mirror.rerun_view import RATE, draw_mirror, mirror_scenery

    health = getattr(rig.driver, "health", None)
    if wanted.rrd is not None:
        temporary = stack.enter_context(atomic_file(wanted.rrd))
        viewer = viewer_of(rig.spec, mirror_scenery(rig.spec), rate=RATE)
        stack.callback(viewer.close)
        samples = draw_mirror(samples, mirror, viewer.to_file(temporary), health)
    if wanted.live is not None:
        viewer = viewer_of(rig.spec, mirror_scenery(rig.spec), rate=RATE, live=True)
        stack.callback(viewer.close)
        if wanted.live == "web":
            tell(f"Open {viewer.serve()}")
        else:
            viewer.spawn()
        samples = draw_mirror(paced(samples) if not rig.live else samples, mirror, viewer, health)
    return samples


def vector(text: str) -> Vector:
    """From `0,0,-9.81`, m/s². Raises ConfigError."""
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise ConfigError(f"--gravity {text}: three numbers with commas between, as 0,0,-9.81") from error
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ConfigError(f"--gravity {text}: three numbers with commas between, as 0,0,-9.81")
    return values


def table(found: MirrorResult, joints: tuple[str, ...]) -> Table:
    """A row a joint: what was expected, what pushed, and from where on that is a touch."""
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


def unnamed(found: MirrorResult, free: Path | None) -> str:
    """Which faults were not looked for, and why; empty where all were."""
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
    """The touches, and what is wrong."""
    said = [
        f"{each.finger} is touched from {each.begin:.3f} to {each.end:.3f} s, by up to {1000 * each.torque:.0f} mN·m"
        + (f", on the link of {spec.joint_labels[each.joint]} or further out" if each.joint >= 0 else "")
        for each in found.contacts
    ]
    said = said or ["Nothing touched it."]
    if found.fault is not None:
        from allegro_twin.twin.mirror.faults import fault_text

        said.append(f"Something is wrong: {fault_text(found.fault, spec)}.")
    return said
