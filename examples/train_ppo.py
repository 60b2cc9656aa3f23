"""Train a policy with PPO and see what it is worth: `python train_ppo.py Grasp`. The same again goes on after a kill.

It is what `allegro-twin train Grasp` does. Needs pip install 'allegro-twin[rl]'.
"""

import sys
from pathlib import Path

from rich.progress import Progress

from allegro_twin.learning import compare_policy, film_policy, load_policy, load_recipe, train, write_report

task = sys.argv[1] if len(sys.argv) > 1 else "reach"
steps = int(sys.argv[2]) if len(sys.argv) > 2 else None  # None: as many as the recipe in conf/training says
recipe, folder = load_recipe(task, steps=steps), Path("runs") / task.lower()

with Progress() as bar:
    job = bar.add_task(task, total=recipe.rounds * recipe.round_steps)

    def advance(done: int, mean: float, rate: float) -> None:
        bar.update(job, completed=done, description=f"{task}: return {mean:.2f}, success {rate:.0%}")

    trained = train(recipe, folder, advance)  # Checkpoints, curve.csv, TensorBoard's log and policy.onnx are in folder.

# Whoever trains again because of this looks elsewhere in the end: `allegro-twin evaluate` has episodes of its own.
compared = compare_policy(trained.policy, recipe, episodes=50, seed=2_000_000_000)
for each in compared:
    print(f"{each.name}: success {each.policy.rate:.1%}, without action {each.no_action.rate:.1%}")
write_report(compared, folder / "evaluation.json")
film_policy(load_policy(trained.policy).policy, recipe, folder / "policy.mp4")
assert all((folder / name).stat().st_size > 0 for name in ("policy.onnx", "evaluation.json", "policy.mp4"))
