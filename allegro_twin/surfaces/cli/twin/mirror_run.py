"""Command `mirror`: run a hand with its mirror, record and draw it, print tables of results."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from allegro_twin.errors import ConfigError, HandError

if TYPE_CHECKING:
    from allegro_twin.app.config import RunConfig
    from allegro_twin.app.rig import Rig
    from allegro_twin.recording.reader import Recording
    from allegro_twin.spec import HandSpec
    from allegro_twin.twin.mirror.contact_detection import Contact
    from allegro_twin.twin.mirror.mirror import Mirror
    from allegro_twin.twin.mirror.on_recording import FreeMotion, MirrorResult
    from allegro_twin.types import Sample, Vector

LATE, BLIND = 2.0, 0.5
"""Times the usual threshold, and share of a motor's torque, above which a joint feels late or is blind. Files that fit
have thresholds of 8 to 13 mN·m, with hard friction up to 45 at rest, and a mirror without a free motion 20."""
LASTS = 1.0
"""s. An impact with more than the motors give is over by then. Ours."""
SHOWN = 4
"""Joints that a sentence names."""


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


class MirroredRun(NamedTuple):
    """A run with a mirror, and how it ended."""

    result: MirrorResult | None
    """None where it ended before the mirror estimated anything."""
    error: HandError | KeyboardInterrupt | None = None
    """What ended it before its time: a fault, a silent bus, Ctrl-C."""


def mirror_file(
    recording: Recording, hand: str, free: Path | None, gravity: Vector | None, into: Path | None
) -> MirroredRun:
    """Run a recording past its mirror, to its end or to Ctrl-C. Arguments as those of `mirror_recording`. Raises
    HandError."""
    from allegro_twin.twin.mirror.on_recording import log_for_recording, run_recording

    log, own = log_for_recording(recording, hand, free, gravity)
    try:
        run_recording(recording, log, into)
    except KeyboardInterrupt as stopped:
        return MirroredRun(log.result(own) if log.rows else None, stopped)
    return MirroredRun(log.result(own))


def run_with_mirror(
    config: RunConfig,
    hand: str,
    outputs: MirrorOutputs,
    advance: Callable[[float], None],
    report: Callable[[str], None],
    warn: Callable[[str], None],
) -> MirroredRun:
    """Run a config's hand with its mirror, to its end or to what ends it. `warn` gets what does not fit before the hand
    moves. Raises HandError for a hand that does not run."""
    from allegro_twin.app.rig import assemble
    from allegro_twin.loop import run, to_the_end, until
    from allegro_twin.twin.mirror.on_recording import MirrorLog, read_free_motion
    from allegro_twin.twin.mirror.on_rig import check_mirrored, mirror_of, wire_version

    rig = assemble(config)
    with closing(rig.backend):
        check_mirrored(rig)
        gravity, free = _gravity(rig, outputs), None
        if outputs.free is not None:
            free = read_free_motion(outputs.free, hand or rig.spec.serial, rig.spec, wire_version(rig), gravity)
            for line in (other_name(free, rig.spec), misfit(free, rig.spec)):
                warn(line)
        thresholds = None if free is None else free.thresholds
        each = mirror_of(rig, hand or rig.spec.serial, thresholds, outputs.stop, gravity)
        log, ended = MirrorLog(each), None
        with ExitStack() as stack:
            samples = log.watch(to_the_end(run(rig.backend, rig.controller)))
            if rig.seconds is not None:
                samples = until(rig.seconds, samples)
            samples = _record(samples, config, rig, each, outputs)
            samples = _draw(samples, rig, each, outputs, stack, report)
            try:
                for sample in samples:
                    advance(sample.state.t)
            except (HandError, KeyboardInterrupt) as error:
                if isinstance(error, ConfigError):
                    raise
                ended = error
            finally:
                stack.enter_context(closing(cast("Generator[Sample]", samples)))
    return MirroredRun(log.result(free) if log.rows else None, ended)


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
        viewer = viewer_of(rig.spec, mirror_scenery(rig.spec), rate=RATE)
        samples = draw_mirror(samples, mirror, stack.enter_context(viewer.recorded(outputs.rrd)), health)
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
    chosen = after_settling(found)
    off, push = (np.sqrt(np.nanmean(np.square(each[chosen]), axis=0)) for each in (found.residual, found.disturbance))
    largest = np.nanmax(np.abs(found.disturbance[chosen]), axis=0)
    usual = usual_thresholds(found)
    for joint, name in enumerate(joints):
        row = (1e6 * off[joint], 1e3 * push[joint], 1e3 * largest[joint], 1e3 * usual[joint])
        made.add_row(name, *(f"{value:.1f}" for value in row))
    return made


def after_settling(found: MirrorResult) -> NDArray[np.bool_]:
    """Rows after the mirror has forgotten where it began, (k,); all of a motion that ended before."""
    from allegro_twin.twin.mirror.contact_detection import SETTLED

    late = found.t > found.t[0] + SETTLED
    return np.asarray(late if late.any() else np.ones_like(late))


def usual_thresholds(found: MirrorResult) -> Vector:
    """From what disturbance on a joint counts as a touch for half of the time, (n,), N·m."""
    return np.asarray(np.median(found.contact_thresholds[after_settling(found)], axis=0))


def misfit(free: FreeMotion, spec: HandSpec) -> str:
    """Why a hand's file does not fit what a free motion shows; empty where it does, and for hands that close their own
    loop, which have no such file."""
    bad = np.flatnonzero(free.unexplained)
    if not len(bad) or "torque" not in spec.commands:
        return ""
    from allegro_twin.twin.identify.results.findings import LEFT

    worst = int(bad[np.argmax(free.excess[bad])])
    joints = f"{len(bad)} of {spec.n_joints} joints more than {LEFT:g} times"
    return (
        f"{free.hand or 'The nominal hand'} does not fit the hand in {free.path}: in free motion it leaves "
        f"{1e3 * free.residual[worst]:.0f} mN·m (rms) at {spec.joint_labels[worst]}, {free.excess[worst]:.0f} times "
        f"what noise explains ({joints}). Thresholds hide that, and touches with it: identify this hand and give its "
        "file with --hand, or give a --free of this hand that touches nothing"
    )


def other_name(free: FreeMotion, spec: HandSpec) -> str:
    """That a free motion is of a hand with another name; empty where it is not."""
    if spec.serial in ("", free.serial) or not free.serial:
        return ""
    return f"{free.path} is of the hand {free.serial}, and this is {spec.serial}: are they one hand?"


def sensitivity(found: MirrorResult, spec: HandSpec) -> str:
    """Which joints feel late or nothing; empty where all feel as they should. Late: from more than LATE times what a
    mirror without a free motion takes for a touch, or in a free motion not explained. Blind: from more than BLIND of
    what the joint's motor gives."""
    from allegro_twin.twin.mirror.fault_detection import Thresholds

    above, names = usual_thresholds(found), spec.joint_labels
    blind = above > BLIND * spec.actuation.torque_limit
    late = above > LATE * Thresholds.default(spec).contact[1]
    if found.free is not None and "torque" in spec.commands:
        late = late | found.free.unexplained
    late &= ~blind
    said = []
    if late.any():
        levers, order = _levers(spec), [k for k in np.argsort(-above, kind="stable") if late[k]]
        each = [
            f"{names[k]} under {1e3 * above[k]:.0f} mN·m (about {above[k] / levers[k]:.1f} N at the tip)" for k in order
        ]
        more = (
            f", and {len(each) - SHOWN} more joints under {1e3 * above[order[SHOWN]]:.0f}" if len(each) > SHOWN else ""
        )
        said.append(f"nothing is felt at {', '.join(each[:SHOWN])}{more}")
    if blind.any():
        which = ", ".join(names[k] for k in np.flatnonzero(blind))
        said.append(f"blind to touches are {which}: thresholds up to {1e3 * above.max():.0f} mN·m, more than "
                    f"{BLIND:g} of what their motors give")  # fmt: skip
    return "; ".join(said)


def _levers(spec: HandSpec) -> Vector:
    """Largest distance of each joint's axis from its fingertip in the middle posture, (n,), m."""
    from allegro_twin.kinematics.hand import hand_kinematics

    middle = np.clip((spec.lower + spec.upper) / 2.0, spec.lower, spec.upper)
    _, jacobians = hand_kinematics(spec).fingertip_jacobians(middle, [finger.name for finger in spec.fingers])
    return np.asarray(np.maximum(np.linalg.norm(jacobians, axis=1).max(axis=0), 1e-3))


def _beyond_motors(contact: Contact, spec: HandSpec) -> str:
    """What a contact may be that pushed a joint by more than any motor of its finger gives; empty for others."""
    if contact.torque <= spec.actuation.torque_limit[list(spec.finger(contact.finger).joints)].max():
        return ""
    if contact.end - contact.begin > LASTS:
        return (
            " (more than its motors give, for longer than an impact: a stop, or an encoder or motor of the wrong sign)"
        )
    return " (more than its motors give: an impact, or a stop)"


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
    """The touches, what could not be felt, and the faults, one line each."""
    from allegro_twin.twin.mirror.faults import fault_text, report_text
    from allegro_twin.twin.mirror.on_recording import possible_cause

    causes = [possible_cause(each, found.faults, spec) for each in found.contacts]
    said = [
        f"{each.finger} is touched from {each.begin:.3f} to {each.end:.3f} s, by up to {1000 * each.torque:.0f} mN·m"
        + _beyond_motors(each, spec)
        + (f", on the link of {spec.joint_labels[each.joint]} or further out" if each.joint >= 0 else "")
        + ("" if cause is None else f"; this may be because {fault_text(cause.fault, spec)}")
        for each, cause in zip(found.contacts, causes, strict=True)
    ]
    if dull := sensitivity(found, spec):
        said.append(f"{'More touches are possible' if said else 'No touch was felt, which says little'}: {dull}.")
    said = said or ["Nothing touched it."]
    return said + [f"Something is wrong: {report_text(each, spec)}." for each in found.faults]
