"""Films of grasps on hidden hands: those of a result, performed again as they were, with a page of all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from allegro_twin.files import atomic_file
from allegro_twin.viewing import film_figure
from allegro_twin.viewing.report import html_page
from studies.rehearsal.hidden_hand import draw_hand
from studies.rehearsal.rehearse import drawn_objects
from studies.rehearsal.sessions import RehearsedHiddenHand, learnt_file

PAGE = "films.html"


class GraspFilm(NamedTuple):
    """One grasp of one hand with one twin."""

    path: Path
    scenario: str
    twin: str
    held: bool
    reason: str
    as_before: bool
    """Whether it ended as the result has it."""


def film_grasps(
    row: Mapping[str, Any], protocol: Mapping[str, Any], folder: Path, *, lost: bool = False
) -> Iterator[GraspFilm]:
    """Perform the grasps of one hand's result again, and film them into a folder. `lost`: only those that did not
    hold."""
    hand = draw_hand(row["number"], protocol["seed"])
    rehearsed = RehearsedHiddenHand(hand, drawn_objects(hand, protocol))
    with learnt_file(row) as file:
        for twin in protocol["twins"]:
            serial = "" if twin == "nominal" else str(file)
            for grasp in row[twin]["grasps"]:
                if lost and grasp["held"]:
                    continue
                path = folder / f"{row['number']:02d}_{twin}_{grasp['scenario']}.mp4"
                report = rehearsed.trial(grasp["scenario"], serial, path)
                same = report.held == grasp["held"]
                yield GraspFilm(path, grasp["scenario"], twin, report.held, report.reason, same)


def write_page(path: Path, films: Mapping[str, Sequence[GraspFilm]]) -> None:
    """A page of films, by the words for their hands; what was lost comes first. Films are linked from beside it."""
    parts = []
    for hand, found in films.items():
        figures = "".join(_figure(each, path.parent) for each in sorted(found, key=lambda film: film.held))
        parts.append(f"<h2>{escape(hand)}</h2><p>{figures}</p>")
    held = [each.held for found in films.values() for each in found]
    about = f"{sum(held)} of the {len(held)} that are shown held"
    with atomic_file(path) as temporary:
        temporary.write_text(html_page("Grasps on hidden hands", about, parts), encoding="utf-8")


def _figure(film: GraspFilm, folder: Path) -> str:
    end = "held" if film.held else film.reason
    other = "" if film.as_before else " (otherwise than in the result)"
    source = film.path.relative_to(folder).as_posix()
    return film_figure(source, f"{film.scenario}, {film.twin}: {end}{other}")
