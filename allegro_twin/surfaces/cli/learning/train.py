"""The command `train`, and the evaluation of a policy."""

from __future__ import annotations

from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.surfaces.cli import completion, options

if TYPE_CHECKING:
    from allegro_twin.learning.training.settings import Recipe

Episodes = Annotated[
    int, typer.Option(help="Episodes of the evaluation, for each set of objects.", callback=options.positive)
]


def train(
    task: Annotated[
        str,
        typer.Argument(help="A task, or a recipe by path or name (`list recipes`).", autocompletion=completion.recipes),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder; default: runs/RECIPE. A training in it continues.", callback=options.folder),
    ] = None,
    hand: options.TrainedHand = None,
    side: Annotated[str | None, typer.Option(help="right or left; default: the recipe's.")] = None,
    device: Annotated[
        str | None, typer.Option(help="Device of the simulation: cpu or warp; default: the recipe's.")
    ] = None,
    steps: Annotated[int | None, typer.Option(help="Total number of actions.")] = None,
    envs: Annotated[int | None, typer.Option(help="Number of parallel simulations.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the training; default: the recipe's.", min=0)] = None,
    log: Annotated[
        str | None, typer.Option(help="Any of tensorboard,csv,wandb; default: the recipe's, or the first two.")
    ] = None,
    sweep: Annotated[
        Path | None, typer.Option(help="YAML with lists of values: a training for each combination.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Trainings of a sweep at once.")] = 1,
    episodes: Episodes = 200,
    video: Annotated[bool, typer.Option(help="Film some episodes at the end.")] = True,
) -> None:
    """Train a policy, or continue an interrupted training."""
    from allegro_twin.files.output_folder import lock_folder
    from allegro_twin.learning.environments.engine import training_differences
    from allegro_twin.learning.training import load_recipe, report
    from allegro_twin.learning.training import train as learn
    from allegro_twin.pick.recipe import load_pick_recipe
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.learning.pick import train_arm_pick

    logs = None if log is None else [name.strip() for name in log.split(",") if name.strip()]
    pick = load_pick_recipe(task, hand=hand, side=side, envs=envs, seed=seed, log=logs)
    if pick is not None:
        for option, value in (("--steps", steps), ("--device", device), ("--sweep", sweep), ("--jobs", jobs)):
            if value not in (None, 1, "cpu"):
                raise ConfigError(f"{option} {value} is for tasks with a batch, and ArmPick has none: leave it out")
        train_arm_pick(pick, task, out, episodes, video)
        return
    recipe = load_recipe(task, hand=hand, side=side, device=device, steps=steps, envs=envs, seed=seed, log=logs)
    if recipe.teacher is not None:
        for line in training_differences(recipe.teacher, recipe.environment):
            console.warn(line)
    if sweep is not None:
        folder = out or Path("runs") / f"{Path(task).stem.lower()}-{sweep.stem}"
        with nullcontext() if out is not None else lock_folder(folder):
            _sweep(sweep, recipe, folder, episodes, jobs)
        return
    if jobs > 1:
        raise ConfigError(f"--jobs {jobs} is for the trainings of a sweep: say --sweep FILE, too, or leave it out")
    folder = out or Path("runs") / Path(task).stem.lower()
    report.check_seeds(recipe, episodes, task)
    kept = _Kept(folder, recipe)
    with ExitStack() as stack:
        stack.enter_context(options.interruptible(progress=kept.line))
        if out is None:
            stack.enter_context(lock_folder(folder))
        bar = stack.enter_context(console.progress())
        job = bar.add_task(recipe.task, total=recipe.total)

        def advance(done: int, mean: float, rate: float) -> None:
            for stale in (report.REPORT, report.FILM):
                (folder / stale).unlink(missing_ok=True)  # Of an earlier policy.
            bar.update(job, completed=done, description=f"{recipe.task}: return {mean:.2f}, success {rate:.0%}")

        trained = learn(recipe, folder, advance, kept, task)
        kept.trained = True
        bar.remove_task(job)
        done = trained.progress
        console.console.print(
            f"{trained.policy}: {done.steps} actions in {done.seconds / 60:.1f} min", soft_wrap=True, markup=False
        )
        _evaluate_and_film(trained.policy, recipe, folder, episodes, video)


class _Kept:
    """Message on the state of a training that somebody interrupts."""

    def __init__(self, folder: Path, recipe: Recipe) -> None:
        self._folder, self._recipe = folder, recipe
        self._steps: int | None = None
        self.trained = False
        """Whether the training has ended, and only its evaluation is missing."""

    def __call__(self, steps: int) -> None:
        """Note the steps of the newest checkpoint."""
        self._steps = steps

    def line(self) -> str:
        if self.trained:
            return f"the policy in {self._folder} is complete, its evaluation is not: the same command makes that"
        if self._steps is None and any(self._folder.glob("checkpoints/[0-9]*.*")):
            return f"the checkpoints in {self._folder} are as they were, and the same command continues"
        if not self._steps:
            first = min(self._recipe.round_steps, self._recipe.total)
            return f"nothing is kept before the first checkpoint, at {first:,} actions: the same command begins anew"
        of = f"{self._steps:,} of {self._recipe.total:,} actions"
        return f"the checkpoint at {of} is kept in {self._folder}, and the same command continues from it"


def _sweep(path: Path, recipe: Recipe, folder: Path, episodes: int, jobs: int) -> None:
    """Train every combination of the values in a file, without films."""
    from rich.markup import escape
    from rich.table import Table

    from allegro_twin.learning.training.sweeping import TABLE, read_variants, train_variants
    from allegro_twin.surfaces.cli import console

    variants, ended = read_variants(path, recipe), 0

    def kept() -> str:
        return (f"{ended} of {len(variants)} trainings had ended; the others keep their last checkpoints in {folder}, "
                "and the same command continues")  # fmt: skip

    with options.interruptible(progress=kept), console.progress() as bar:
        job = bar.add_task(f"{recipe.task}: trainings", total=len(variants))

        def advance(done: int, of: int) -> None:
            nonlocal ended
            ended = done
            bar.update(job, completed=done, total=of)

        rows = train_variants(variants, folder, episodes, jobs, advance)
    table = Table(title=escape(str(folder / TABLE)), title_justify="left", title_style="bold")
    columns = list(dict.fromkeys(name for row in rows for name in row))
    for column in columns:
        table.add_column(escape(column), overflow="fold")
    for row in rows:
        table.add_row(*(_cell(row.get(column)) for column in columns))
    console.console.print(table)


def _cell(value: object) -> str:
    from rich.markup import escape

    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else escape(str(value))


def evaluate_policy(
    policy: str,
    recipe: str,
    episodes: int,
    can: int,
    hand: str | None = None,
    side: str | None = None,
    film: Path | None = None,
    seed: int | None = None,
) -> None:
    """Compare a policy with the script in the same episodes, with seeds from `seed` on; `can` of them also run on a
    virtual CAN bus. Raises HandError."""
    from allegro_twin.files.assets import find_file
    from allegro_twin.learning.environments.engine import training_differences
    from allegro_twin.learning.policy.loading import load_policy
    from allegro_twin.learning.training import load_recipe, report
    from allegro_twin.pick.recipe import load_pick_recipe
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.learning.pick import evaluate_arm_pick

    if not 0 <= can <= episodes:
        raise ConfigError(f"--can must be 0 to --episodes, which is {episodes}; not {can}")
    pick = load_pick_recipe(recipe, hand=hand, side=side)
    if pick is not None:
        if can:
            raise ConfigError(f"--can {can}: an episode of ArmPick has an arm, which is on no CAN bus: leave it out")
        evaluate_arm_pick(policy, pick, episodes, film, report.SEED if seed is None else seed)
        return
    loaded = load_recipe(recipe, hand=hand, side=side)
    report.check_objects(loaded, recipe)
    if can:
        from allegro_twin.learning.training.deployment import check_can

        check_can(loaded.environment)
    first = report.SEED if seed is None else seed
    if used := report.seeds_overlap(loaded, first, episodes):
        console.warn(
            f"seeds {first} to {first + episodes - 1}: some are those of {used}: the rates are not of unseen episodes"
        )
    path = find_file(policy, "policy", "conf/policies", ".onnx")
    for line in training_differences(policy, loaded.environment):
        console.warn(line)
    if film is not None:
        report.film_policy(load_policy(path).policy, loaded, film, seed=first)
    console.console.print(console.policy_table(report.compare_policy(path, loaded, episodes, first), loaded, first))
    if can:
        from allegro_twin.learning.tasks import task_type
        from allegro_twin.learning.training.deployment import evaluate_on_can

        for name, settings in report.evaluation_sets(loaded).items():
            driven = evaluate_on_can(path, loaded.task, settings, can, seed=first)
            share = console.success_rate(driven)
            more = "" if driven.counts is None else f", {driven.counts.mean():.1f} {task_type(loaded.task).count_unit}"
            more += "".join(f", {part.replace('_', ' ')} {share.mean():.0%}" for part, share in driven.shares.items())
            console.say(f"over CAN, {name}: {share} of the first {can} of these episodes{more}")


def _evaluate_and_film(policy: Path, recipe: Recipe, folder: Path, episodes: int, video: bool) -> None:
    from allegro_twin.learning.policy.loading import load_policy
    from allegro_twin.learning.training import report
    from allegro_twin.surfaces.cli import console

    compared = report.compare_policy(policy, recipe, episodes, report.SELECTION)
    report.write_report(compared, folder / report.REPORT)
    console.console.print(console.policy_table(compared, recipe, report.SELECTION))
    if not video:
        return
    try:
        report.film_policy(load_policy(policy).policy, recipe, folder / report.FILM, seed=report.SELECTION)
    except (ConfigError, RecordingError) as error:
        console.warn(f"no film: {error}")  # A film is optional.
