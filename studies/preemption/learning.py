"""Learning when to close: which policy a trial gets, by what is known before it.

For each policy k that may be chosen, logit p_k = w_k · x with x of the errors to expect, the time of the approach and
the object's size, fitted on train with a ridge. A trial gets the policy with the most expected successes a second,
p_k / t_k with t_k its mean cycle on train, among those with p_k ≥ p_baseline - allowance; the baseline always is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from allegro_twin.types import Array
from studies.preemption.dose_response import logistic
from studies.preemption.measures import Row
from studies.preemption.protocol import ArmStudy


@dataclass(frozen=True, slots=True, eq=False)
class LearnedChoice:
    """What was learned of one hand."""

    study: ArmStudy
    weights: Mapping[str, Array]
    """Of each policy, (m,)."""
    seconds: Mapping[str, float]
    """Its mean cycle on train; that of what never held is not a number."""

    def success(self, row: Row) -> dict[str, float]:
        """The predicted rate of each policy in a trial."""
        x = context(self.study, row)
        return {name: float(1.0 / (1.0 + np.exp(-x @ weights))) for name, weights in self.weights.items()}

    def policy(self, row: Row) -> str:
        """The one that a trial gets; of the trial only what is known before it counts."""
        learned, baseline = self.study.learned, self.study.analysis.baseline
        success = self.success(row)
        least = success[baseline] - learned.allowance
        good = [name for name in learned.options if success[name] >= least and self.seconds[name] > 0.0]
        return max(good, key=lambda name: success[name] / self.seconds[name], default=baseline)


def learn(study: ArmStudy, train: Mapping[str, Sequence[Row]]) -> LearnedChoice:
    """From the rows of train, by policy."""
    weights, seconds = dict[str, Array](), dict[str, float]()
    for name in dict.fromkeys((study.analysis.baseline, *study.learned.options)):
        rows = train[name]
        design = np.array([context(study, row) for row in rows])
        held = np.array([float(row["held"]) for row in rows])
        ridge = np.full(design.shape[1], study.learned.ridge)
        ridge[0] = 1e-3  # The rate itself is hardly drawn anywhere.
        weights[name] = logistic(design, held, ridge)
        cycles = np.array([float(row["cycle_s"]) for row in rows])
        cycles = cycles[np.isfinite(cycles)]
        seconds[name] = float(cycles.mean()) if len(cycles) else float("nan")
    return LearnedChoice(study, weights, seconds)


def context(study: ArmStudy, row: Row) -> Array:
    """x, (7,): 1, the standard deviations of place (cm) and yaw (10°), the time of the approach (s, less 1.2), and the
    object's least and largest extent and its height (dm, less those of a fist)."""
    size = study.objects[str(row["object"])].extents
    return np.array([
        1.0, 0.1 * float(row["sigma_mm"]), 0.1 * float(row["sigma_deg"]), float(row["approach_s"]) - 1.2,
        10.0 * min(size) - 0.6, 10.0 * max(size) - 1.0, 10.0 * size[2] - 0.8,
    ])  # fmt: skip
