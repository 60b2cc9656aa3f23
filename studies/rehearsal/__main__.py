"""`python -m studies.rehearsal`: register the rehearsal, run its hands, and write its table."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Annotated, Any

import typer

from allegro_twin import ConfigError
from allegro_twin.files import atomic_file, fingerprint, read_yaml, source_fingerprint
from studies.rehearsal.rehearse import rehearse
from studies.rehearsal.report import policy_table, scores, table

FOLDER = Path(__file__).parent
PROTOCOL, REGISTRATION = FOLDER / "rehearsal.yaml", FOLDER / "rehearsal.registration.json"
app = typer.Typer(
    pretty_exceptions_enable=False, context_settings={"help_option_names": ["-h", "--help"]},
    help="What grasps and motions lose on hands that nobody has seen.",
)  # fmt: skip
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
    folder: Annotated[Path, typer.Argument(help="Of `run`.")] = Path("out/rehearsal"),
    commit: Annotated[str, typer.Option(help="That the results are of.")] = "",
    write_scores: Annotated[
        Path | None, typer.Option("--scores", help="Write what `allegro-twin rehearse` compares with: a .json.")
    ] = None,
) -> None:
    """Print the table of the results in a folder."""
    rows: list[dict[str, Any]] = [json.loads(path.read_text()) for path in sorted(folder.glob("[0-9]*.json"))]
    if not rows:
        raise ConfigError(f"{folder} has no results: python -m studies.rehearsal run --out {folder} makes them")
    typer.echo(table(rows))
    typer.echo(f"\n{policy_table(rows)}".rstrip())
    if write_scores is None:
        return
    how = "registered" if all(row.get("registered") for row in rows) else "not all registered"
    about = f"{len(rows)} hidden hands ({how}; docs/results/rehearsal.md), of commit {commit or 'unknown'}."
    with atomic_file(write_scores) as temporary:
        temporary.write_text(json.dumps(scores(rows, about), indent=1) + "\n")


def contents() -> dict[str, str]:
    """Fingerprints of what the results are made of, besides the package that is judged."""
    modules = ("hidden_hand", "motor_laws", "policies", "sessions", "rehearse")
    return {"protocol": fingerprint(PROTOCOL)} | {
        name: fingerprint(FOLDER / f"{name}.py") for name in modules
    } | {"package": source_fingerprint("studies.rehearsal.rehearse")}  # fmt: skip


if __name__ == "__main__":
    app()
