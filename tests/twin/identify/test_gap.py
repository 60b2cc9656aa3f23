"""What a gap counts, and which joints an identification says are worse for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify import pipeline
from allegro_twin.twin.identify.motions.motion import RecordedMotion, read_motion
from allegro_twin.twin.identify.results.findings import describe_worse
from allegro_twin.twin.identify.results.gap import GapErrors, drive_parameters, gap_errors
from allegro_twin.twin.identify.results.written_drive import SOURCES, WrittenDrive
from tests.twin.free_motion import free_motion

N = 16
INDEX = slice(0, 4)


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> RecordedMotion:
    return read_motion(free_motion(tmp_path_factory.mktemp("free") / "free.arrow"))


def torn(motion: RecordedMotion) -> RecordedMotion:
    """Its index finger is 0.2 rad elsewhere for a second; of that, and of 0.3 s around it, nothing can be trusted."""
    position, good = motion.position.copy(), motion.good.copy()
    position[900:1250, INDEX] += 0.2
    good[800:1350, INDEX] = 0.0
    return replace(motion, position=position, good=good)


def errors(motion: RecordedMotion) -> GapErrors:
    drive = drive_parameters(motion.spec, np.ones(N), np.zeros(N))
    return gap_errors(motion, OpenLoopPlayer(motion.spec, motion.period), drive, (0.1, 0.3))


def test_a_gap_leaves_out_what_the_fit_leaves_out(motion: RecordedMotion) -> None:
    whole, part = errors(motion), errors(torn(motion))
    assert whole.joint.max() < 1e-3
    assert part.joint.max() < 1e-3
    assert np.nanmax(part.phase) < 1e-3
    np.testing.assert_allclose(part.joint[:, 4:], whole.joint[:, 4:], rtol=1e-3)


def test_a_recording_that_the_fit_would_refuse_has_no_gap(motion: RecordedMotion) -> None:
    late = replace(motion, good=motion.good * (np.arange(len(motion.good)) % 20 > 5)[:, None])
    with pytest.raises(ConfigError, match=r"free.arrow: 0 % of its rows can be used: too few reports arrived"):
        pipeline._gap(late, "")


def test_joints_that_a_file_predicts_worse_than_the_nominal_hand_are_named(spec: HandSpec) -> None:
    nominal, now = np.full(N, 0.010), np.full(N, 0.001)
    drive = drive_parameters(spec, np.ones(N), np.zeros(N))
    written = WrittenDrive(drive, tuple(SOURCES[1] for _ in range(N)), {"nominal": nominal, "written": now}, 1.0)
    assert describe_worse(written, spec) == ""
    now[11], now[2], now[5] = 0.013, 0.020, 0.0102
    assert describe_worse(written, spec).startswith(
        "Written and worse than nominal there: index_2 (20.0 mrad, nominal 10.0), ring_3 (13.0 mrad, nominal 10.0). "
    )
