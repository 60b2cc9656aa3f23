"""A grasp squeezed with less: no joint is to give more than a share of its torque limit for as long as it holds.

A position grasp tells joint j to go δⱼ = qⱼ(squeeze) − qⱼ(rest) beyond where the object stops it, and gives kp δⱼ, up
to its limit. What it sustains is the root mean square of that over the trial, as a share of the limit: what warms the
motor. First no joint is told to give more than the share; then all δ shrink together, for forces inside a grasp are in
proportion, and a joint that gives way alone is only pushed further by the others.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.plan.candidate import limit_squeeze, rest_positions, round_posture
from allegro_twin.grasping.scenario import Scenario
from allegro_twin.hands.library.entries import LatchGrip
from allegro_twin.hands.library.grasps import Grasp

TRIALS = 8
"""At most: the first as it is, the second with joints limited, and others with all squeezed less."""
BELOW = 0.98
"""Share of the allowed value that is aimed at, so that the next trial does not end just above it."""


class EasedGrasp(NamedTuple):
    """The grasp with its squeeze as small as was asked, and its last whole trial."""

    grasp: Grasp
    verdict: Verdict

    @property
    def sustained(self) -> float:
        """Share of its limit that the hottest joint sustains; NaN where the object was lost."""
        report = self.verdict.report
        return report.hottest[1] if report is not None and report.held else math.nan

    def within(self, share: float) -> bool:
        """Whether it holds, and no joint sustains more than that."""
        return self.sustained <= share


def ease_squeeze(scenario: Scenario, grasp: Grasp, runner: TrialRunner, share: float, folder: Path) -> EasedGrasp:
    """Reduce the squeeze until no joint sustains more than `share` of its limit, or the object is lost. Raises
    HandError."""
    spec, gains = runner.spec, runner.gains
    for trial in range(TRIALS):
        (verdict,) = runner.verdicts([TrialCase(scenario, grasp, folder=folder)], rest_positions)
        if not verdict.held or verdict.report is None or not verdict.measured:
            break
        hottest = verdict.report.hottest[1]
        if hottest <= share or trial == TRIALS - 1:
            break
        rest = np.array([verdict.measured[joint] for joint in spec.joints])
        if trial == 0:
            grasp = limit_squeeze(grasp, rest, gains, spec, share)
            continue
        rest = grasp.close if isinstance(grasp.grip, LatchGrip) else rest
        less = BELOW * share / hottest
        grasp = replace(grasp, squeeze=round_posture(rest + less * (grasp.squeeze - rest), spec))
    return EasedGrasp(grasp, verdict)
