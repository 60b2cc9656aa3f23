"""`python -m studies.preemption`: run the trials of the study, register it, and write its report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin import ConfigError
from allegro_twin.surfaces.cli import exit_codes, options

Out = Annotated[
    Path,
    typer.Option("--out", "-o", help="Folder for trials and report; what is there goes on.", callback=options.folder),
]


app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Does closing the hand while the arm still moves beat reach-then-grasp?",
)


@app.command("run")
def preemption(
    hand: Annotated[list[str] | None, typer.Option(help="One of the protocol's, or several; by default all.")] = None,
    pairs: Annotated[int | None, typer.Option(help="Of test, a hand; by default all of the protocol.")] = None,
    out: Out = Path("out/preemption"),
    protocol: Annotated[str, typer.Option(help="A protocol's name, or a file.")] = "preemption",
    engine: Annotated[options.Engines, typer.Option(help="This computer, or a Ray cluster.")] = options.Engines.local,
    address: Annotated[str | None, typer.Option(help="Of the cluster, as HOST:PORT.")] = None,
    count: options.Count = None,
    exploratory: Annotated[
        bool, typer.Option("--exploratory", help="Although the registration does not fit; the results say so.")
    ] = False,
) -> None:
    """Make the trials of a study, and its report. The same command again goes on after an interruption; results under
    another protocol are refused, and a registration that no longer fits is, too."""
    from allegro_twin.surfaces.cli import console, engine_of
    from allegro_twin.sweep import Store, run
    from studies.preemption.folder import TRIALS
    from studies.preemption.jobs import pairs_of, sweep_of
    from studies.preemption.protocol import load_study
    from studies.preemption.registration import stamp_of

    study = load_study(protocol)
    hands, count_of = study.of(tuple(hand or ())), pairs_of(study, pairs)
    sweep = sweep_of(study, hands, count_of, stamp_of(study, protocol, exploratory=exploratory))
    chosen = engine_of(engine.value, address, count)
    with console.progress() as bar:
        task = bar.add_task("trials", total=len(sweep.items))
        run(
            sweep,
            Store(out / TRIALS, console.warn),
            chosen.engine,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    _say([out], out)


@app.command("prepare")
def prepared(
    hand: Annotated[list[str] | None, typer.Option(help="One of the protocol's, or several; by default all.")] = None,
    protocol: Annotated[str, typer.Option(help="A protocol's name, or a file.")] = "preemption_arm",
) -> None:
    """Plan how each hand takes each object of a protocol with the arm in the loop: once, before it is registered."""
    from allegro_twin.surfaces.cli import console
    from studies.preemption.arm.grasps import FOLDER
    from studies.preemption.arm.prepare import prepare
    from studies.preemption.protocol import ArmStudy, load_study

    study = load_study(protocol)
    if not isinstance(study, ArmStudy):
        raise ConfigError(f"{protocol}: its hands are on a spring, and its grasps are those of scenarios")
    for name in study.of(tuple(hand or ())):
        path = prepare(study, name, FOLDER, lambda line: console.console.print(line, soft_wrap=True, highlight=False))
        console.console.print(f"{path}", soft_wrap=True, highlight=False)


@app.command("register")
def registered(
    protocol: Annotated[str, typer.Argument(help="A protocol's name, or a file; its registration goes beside it.")],
    when: Annotated[str, typer.Option(help="And of which state of the repository; in words.")],
) -> None:
    """Register a study before its first trial: a fingerprint of its protocol, and of all models, grasps, objects and
    code that its trials are made of. Trials are made under it as long as none of that has changed."""
    from allegro_twin.surfaces.cli import console
    from studies.preemption.protocol import load_study
    from studies.preemption.registration import place_of, register

    path = place_of(protocol)
    made = register(load_study(protocol), path, when)
    console.console.print(f"{path}: registration {made.digest} of {len(made.contents)} contents", soft_wrap=True)


@app.command()
def report(
    folders: Annotated[
        list[Path], typer.Argument(help="Of a study, whole or not yet; each hand from the last with it.")
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="By default the folder, if it is one.")] = None,
    where: Annotated[str, typer.Option(help="On which machine it was made, and when: stands in the report.")] = "",
) -> None:
    """Write the report of the trials that folders have, as one study, and say what they show: hands may be made by as
    many programs, each into a folder of its own, and one that is made anew takes the place of the old one."""
    from allegro_twin.files import lock_folder

    if out is None and len(folders) > 1:
        raise ConfigError(f"{len(folders)} folders: say with --out where their one report goes")
    folder = folders[0] if out is None else out
    with lock_folder(folder):
        _say(folders, folder, where)


def _say(folders: list[Path], folder: Path, where: str = "") -> None:
    from allegro_twin.surfaces.cli import console
    from studies.preemption import report_text
    from studies.preemption.analysis import analysed
    from studies.preemption.folder import gathered, write
    from studies.preemption.registration import status_of

    held = gathered(folders)
    write(held, folder, where)
    if len(folders) > 1:
        told_of = ", ".join(f"{count} of {hand}" for hand, count in sorted(held.hands.items()))
        console.console.print(f"Trials: {told_of}", soft_wrap=True, highlight=False)
    console.console.print(status_of(held.stamps), soft_wrap=True, highlight=False)
    answer = analysed(held.table.to_pylist(), held.study)
    for found in answer.findings:
        console.console.print(report_text.sentence(found, answer, held.study), soft_wrap=True, highlight=False)
    console.console.print(report_text.answer_of(answer, held.study), soft_wrap=True, highlight=False)
    console.console.print(f"In {folder}/: report.html, trials.parquet with a row a trial", soft_wrap=True)


if __name__ == "__main__":
    exit_codes.run(app, sys.argv[1:] or ["--help"], "python -m studies.preemption")
