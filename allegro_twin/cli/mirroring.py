"""What `allegro-twin mirror` does and shows, apart from the command line."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from allegro_twin.errors import ConfigError

if TYPE_CHECKING:
    from allegro_twin.build.mirroring import Mirrored
    from allegro_twin.config import RunConfig


def live(
    config: RunConfig, hand: str, free: Path | None, stop: bool, record: Path | None, advance: Callable[[float], None]
) -> Mirrored:
    """Run a config's hand with its mirror beside it. Raises HandError; HandFault for a touch that is to stop it."""
    from allegro_twin.build.assemble import assemble
    from allegro_twin.build.mirroring import DEFAULT, Mirrored, limits, make_mirror
    from allegro_twin.build.wired import codec_of
    from allegro_twin.config import CanSettings
    from allegro_twin.loop import run, to_the_end, until
    from allegro_twin.mirror.events import contacts
    from allegro_twin.replay.recorder import recorded

    if not isinstance(config.backend, CanSettings):
        raise ConfigError(
            f"a {config.backend.kind} hand is its own twin: `mirror` is for hands on a bus, and recordings"
        )
    codec, rig = codec_of(config, config.backend), assemble(config)
    above = np.full(rig.spec.n_joints, DEFAULT) if free is None else limits(free, hand or rig.spec.serial)
    each = make_mirror(rig.spec, hand or rig.spec.serial, codec.version, codec.calibration, config.period,
                       above if stop else None)  # fmt: skip
    rows = []
    with closing(rig.backend):
        samples = each.watched(to_the_end(run(rig.backend, rig.controller)))
        if rig.seconds is not None:
            samples = until(rig.seconds, samples)
        if record is not None and rig.wire is not None:
            meta: dict[str, object] = {"calibration": rig.wire.calibration, "config": config.model_dump(mode="json")}
            meta |= rig.sim.meta() if rig.sim is not None else {}
            samples = recorded(samples, record, rig.spec, config.period, meta=meta, extras=each.latest)
        for sample in samples:
            latest = each.latest()
            rows.append((sample.state.t, latest["disturbance"], sample.state.position - latest["predicted"]))
            advance(sample.state.t)
    t, disturbance, off = (np.array(column) for column in zip(*rows[1:], strict=True))
    return Mirrored(t, disturbance, off, above, tuple(contacts(t, disturbance, above, rig.spec)))


def table(found: Mirrored, joints: tuple[str, ...]) -> Table:
    """A row a joint: what was expected, what pushed, and from where on that is a touch."""
    made = Table(title=f"{found.t[-1] - found.t[0]:.1f} s beside the model")
    made.add_column("joint")
    for head in ("off by, rms\nµrad", "pushed, rms\nmN·m", "largest\nmN·m", "a touch from\nmN·m"):
        made.add_column(head, justify="right")
    chosen = found.t > found.t[0] + 1.0
    off, push = (np.sqrt(np.square(each[chosen]).mean(axis=0)) for each in (found.off, found.disturbance))
    largest = np.abs(found.disturbance[chosen]).max(axis=0)
    for joint, name in enumerate(joints):
        row = (1e6 * off[joint], 1e3 * push[joint], 1e3 * largest[joint], 1e3 * found.above[joint])
        made.add_row(name, *(f"{value:.1f}" for value in row))
    return made


def lines(found: Mirrored) -> list[str]:
    """The touches."""
    said = [
        f"{each.finger} is touched from {each.begin:.3f} to {each.end:.3f} s, by up to {1000 * each.torque:.0f} mN·m"
        for each in found.contacts
    ]
    return said or ["Nothing touched it."]
