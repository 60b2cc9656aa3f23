"""Table of the Gymnasium environments."""

from __future__ import annotations

from rich.table import Table

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.gym import NAMESPACE, PICK, VERSION
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.spaces import action_space, describe_space, observation_space
from allegro_twin.learning.tasks import NO_BATCH, TASKS, make_task, task_names
from allegro_twin.pick.env import ArmPick


def environment_table(only: str = "") -> Table:
    """All environments, or those of one task, also of an installed package or `module:Class` of your own. Raises
    ConfigError with the nearest names."""
    if only and ":" not in only and only not in (known := (*task_names(), NO_BATCH)):
        raise ConfigError(unknown("task", only, known))
    table = Table(title="environments", title_justify="left", title_style="bold")
    for column in ("id", "what for", "observation", "action", "actions an episode"):
        table.add_column(column, overflow="fold")
    for name in TASKS if not only else [only] if only != NO_BATCH else []:
        task = make_task(name, EnvSettings(), 1, 1)
        privileged = " (privileged: sees what no real hand reports)" if task.n_privileged else ""
        table.add_row(
            task.id,
            task.purpose + privileged,
            describe_space(observation_space(task)),
            describe_space(action_space(task)),
            str(round(task.seconds / task.interface.seconds)),
        )
    if only in ("", NO_BATCH):
        pick = ArmPick()
        row = describe_space(pick.observation_space), describe_space(pick.action_space), str(pick.episodes.limit)
        table.add_row(PICK, "take a thing off a table with an arm: one at a time, without a batch", *row)
        pick.close()
    table.caption = f"{NAMESPACE}/{next(iter(TASKS))}Left-v{VERSION} and so on are the left hand's; or give side='left'"
    table.caption_justify = "left"
    return table
