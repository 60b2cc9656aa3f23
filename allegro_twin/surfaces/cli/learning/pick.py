"""Training and evaluation of policies for `ArmPick`, for the commands `train` and `evaluate`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.pick.recipe import PickRecipe


def train_arm_pick(recipe: PickRecipe, named: str, out: Path | None, episodes: int, video: bool) -> None:
    """Train a policy in the folder `out`, or runs/RECIPE, or continue; then evaluate and film it. Raises HandError."""
    from allegro_twin.files.output_folder import lock_folder
    from allegro_twin.learning.training import report
    from allegro_twin.learning.training.report import SELECTION
    from allegro_twin.pick.report import compare_pick, film_pick
    from allegro_twin.pick.training import train_pick
    from allegro_twin.surfaces.cli import console

    folder = out or Path("runs") / Path(named).stem.lower()
    rounds, trained = 0, False

    def line() -> str:
        if trained:
            return f"the policy in {folder} is complete, its evaluation is not: the same command makes that"
        if not rounds:
            return "nothing is kept before the end of the first round: the same command begins anew"
        return f"round {rounds} of {recipe.rounds} is kept in {folder}, and the same command continues after it"

    def kept(number: int) -> None:
        nonlocal rounds
        rounds = number

    with ExitStack() as stack:
        stack.enter_context(options.interruptible(progress=line))
        if out is None:
            stack.enter_context(lock_folder(folder))
        bar = stack.enter_context(console.progress())
        job = bar.add_task("ArmPick: episodes", total=recipe.rounds * recipe.episodes)

        def advance(done: int) -> None:
            for stale in (report.REPORT, report.FILM):
                (folder / stale).unlink(missing_ok=True)  # Of an earlier policy.
            bar.update(job, completed=done)

        found = train_pick(recipe, folder, advance, kept, named)
        trained = True
        bar.remove_task(job)
        done = found.progress
        console.console.print(
            f"{found.policy}: {done.steps} states in {done.seconds / 60:.1f} min", soft_wrap=True, markup=False
        )
        compared = compare_pick(found.policy, recipe, episodes, SELECTION)
        report.write_report(compared, folder / report.REPORT)
        console.console.print(console.pick_table(compared, SELECTION))
        if not video:
            return
        try:
            film_pick(found.policy, recipe, folder / report.FILM, seed=SELECTION)
        except (ConfigError, RecordingError) as error:
            console.warn(f"no film: {error}")  # A film is optional.


def evaluate_arm_pick(policy: str, recipe: PickRecipe, episodes: int, film: Path | None, seed: int) -> None:
    """Compare a policy with the script in the same episodes, with seeds from `seed` on. Raises HandError."""
    from allegro_twin.learning.policy.loading import policy_file
    from allegro_twin.pick.report import check_pick_policy, compare_pick, film_pick
    from allegro_twin.surfaces.cli import console

    path, used = policy_file(policy), recipe.training_seeds()
    check_pick_policy(path, recipe)
    if max(seed, used.start) < min(seed + episodes, used.stop):
        console.warn(
            f"seeds {seed} to {seed + episodes - 1}: some are those of the training: the rates are not of unseen "
            "episodes"
        )
    if film is not None:
        film_pick(path, recipe, film, seed=seed)
    console.console.print(console.pick_table(compare_pick(path, recipe, episodes, seed), seed))
