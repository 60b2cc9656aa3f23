"""`python -m studies.rehearsal`: register the rehearsal, run its hands, and write its table."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Annotated, Any

import typer

from allegro_twin import ConfigError
from allegro_twin.files import atomic_file, fingerprint, read_yaml, source_fingerprint
from studies.rehearsal.films import PAGE, GraspFilm, film_grasps, write_page
from studies.rehearsal.hidden_hand import draw_hand
from studies.rehearsal.planned import try_planned
from studies.rehearsal.policies import POLICY_SEED, try_policies
from studies.rehearsal.rehearse import rehearse
from studies.rehearsal.report import planned_table, policy_table, scores, table, trajectory_table
from studies.rehearsal.sessions import learnt_file
from studies.rehearsal.trajectories import try_trajectories

FOLDER = Path(__file__).parent
PROTOCOL, REGISTRATION = FOLDER / "rehearsal.yaml", FOLDER / "rehearsal.registration.json"
app = typer.Typer(
    pretty_exceptions_enable=False, context_settings={"help_option_names": ["-h", "--help"]},
    help="What grasps and motions lose on hands that nobody has seen.",
)  # fmt: skip
Results = Annotated[Path, typer.Argument(help="Of `run`.")]
Hands = Annotated[str | None, typer.Option(help="Numbers, separated by commas; default: all.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder of the results; what is there goes on.")]


@app.command("register")
def register() -> None:
    """Write down the protocol and the hidden hands' code, before the first hand is drawn."""
    with atomic_file(REGISTRATION) as temporary:
        temporary.write_text(json.dumps(contents(), indent=1) + "\n")


@app.command("run")
def run_all(
    out: Out = Path("out/rehearsal"),
    jobs: Annotated[int, typer.Option(help="Hands at once.", min=1)] = 2,
    first: Annotated[int, typer.Option(help="Number of the first hand.", min=0)] = 0,
    exploratory: Annotated[bool, typer.Option("--exploratory", help="Although the registration does not fit.")] = False,
) -> None:
    """Rehearse every hand that is not in the folder yet."""
    registered = REGISTRATION.exists() and json.loads(REGISTRATION.read_text()) == contents()
    if not registered and not exploratory:
        raise ConfigError("the registration does not fit the protocol and code as they are: say --exploratory")
    protocol = read_yaml(PROTOCOL) | {"registered": registered}
    missing = [k for k in range(first, protocol["hands"]) if not (out / f"{k:02d}.json").exists()]
    out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(jobs) as pool:
        running = {pool.submit(rehearse, number, protocol): number for number in missing}
        for future in as_completed(running):
            number, found = running[future], future.result()
            with atomic_file(out / f"{number:02d}.json") as temporary:
                temporary.write_text(json.dumps(found | {"registered": registered}, indent=1))
            typer.echo(f"hand {number}: done")


@app.command("report")
def report(
    folder: Results = Path("out/rehearsal"),
    commit: Annotated[str, typer.Option(help="That the results are of.")] = "",
    write_scores: Annotated[
        Path | None, typer.Option("--scores", help="Write what `allegro-twin rehearse` compares with: a .json.")
    ] = None,
) -> None:
    """Print the table of the results in a folder."""
    rows = [row for _, row in _results(folder)]
    typer.echo(table(rows))
    for more in (trajectory_table(rows), policy_table(rows), planned_table(rows)):
        if more:
            typer.echo(f"\n{more}")
    if write_scores is None:
        return
    how = "registered" if all(row.get("registered") for row in rows) else "not all registered"
    about = f"{len(rows)} hidden hands ({how}; docs/results/rehearsal.md), of commit {commit or 'unknown'}."
    with atomic_file(write_scores) as temporary:
        temporary.write_text(json.dumps(scores(rows, about), indent=1) + "\n")


@app.command("policies")
def policies(
    folder: Results = Path("out/rehearsal"),
    hands: Hands = None,
) -> None:
    """Try shipped policies on the hands of the results in a folder that have none, with the files that were learnt."""
    protocol = read_yaml(PROTOCOL)
    for path, row in _results(folder, hands):
        if "policies" in row or not _is_learnt(row):
            continue
        with learnt_file(row) as file:
            hand = draw_hand(row["number"], protocol["seed"])
            row["policies"] = try_policies(hand, file, POLICY_SEED + 1000 * row["number"])
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(row, indent=1))
        typer.echo(f"hand {row['number']}: done")


@app.command("planned")
def planned(
    folder: Results = Path("out/rehearsal"),
    hands: Hands = None,
    candidates: Annotated[int, typer.Option(help="Budget of each plan.", min=1)] = 100,
) -> None:
    """Plan grasps for the nominal hand and for the learnt files of right hands, and perform the best."""
    protocol = read_yaml(PROTOCOL)
    for path, row in _results(folder, hands):
        if "planned" in row or row["side"] != "right" or not _is_learnt(row):
            continue
        row["planned"] = try_planned(row, protocol, folder / "plans", candidates, typer.echo)
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(row, indent=1))


@app.command("trajectories")
def trajectories(
    folder: Results = Path("out/rehearsal"),
    hands: Hands = None,
) -> None:
    """Follow the trajectory on the hands of the results in a folder that have none, with the files that were learnt."""
    protocol = read_yaml(PROTOCOL)
    for path, row in _results(folder, hands):
        if not _is_learnt(row) or all(row[twin].get("trajectories") for twin in protocol["twins"]):
            continue
        for twin, found in try_trajectories(row, protocol).items():
            row[twin]["trajectories"] = found
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(row, indent=1))
        typer.echo(f"hand {row['number']}: done")


@app.command("films")
def films(
    folder: Results = Path("out/rehearsal"),
    hands: Hands = None,
    lost: Annotated[bool, typer.Option("--lost", help="Only grasps that did not hold.")] = False,
) -> None:
    """Film the grasps of the results in a folder, performed again, with a page of all of them."""
    protocol, made = read_yaml(PROTOCOL), dict[str, list[GraspFilm]]()
    for _, row in _results(folder, hands):
        name = f"Hand {row['number']}, {row['side']} {row['version']}: {', '.join(row['traits']) or 'as our drives'}"
        for film in film_grasps(row, protocol, folder / "films", lost=lost):
            made.setdefault(name, []).append(film)
            typer.echo(f"{film.path}: {'held' if film.held else film.reason}")
    if not made:
        raise ConfigError(f"{folder} has no grasp to film{' that was lost' if lost else ''}")
    write_page(folder / PAGE, made)
    typer.echo(f"Page: {folder / PAGE}")


def _is_learnt(row: Mapping[str, Any]) -> bool:
    return "\nidentified:" in row.get("file", "")


def _results(folder: Path, hands: str | None = None) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Files of results and what they have; of some hands, by their numbers. Raises ConfigError where there is none."""
    try:
        chosen = None if hands is None else {int(each) for each in hands.split(",")}
    except ValueError:
        raise ConfigError(f"--hands are numbers, separated by commas, not {hands!r}") from None
    rows = [(path, json.loads(path.read_text())) for path in sorted(folder.glob("[0-9]*.json"))]
    found = [(path, row) for path, row in rows if chosen is None or row["number"] in chosen]
    if not found:
        raise ConfigError(f"{folder} has no such results: python -m studies.rehearsal run --out {folder} makes them")
    yield from found


def contents() -> dict[str, str]:
    """Fingerprints of what the results are made of, besides the package that is judged."""
    modules = ("hidden_hand", "motor_laws", "policies", "sessions", "rehearse")
    return {"protocol": fingerprint(PROTOCOL)} | {
        name: fingerprint(FOLDER / f"{name}.py") for name in modules
    } | {"package": source_fingerprint("studies.rehearsal.rehearse")}  # fmt: skip


if __name__ == "__main__":
    app()
