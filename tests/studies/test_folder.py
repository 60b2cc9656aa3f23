"""A folder of the study: it goes on, it refuses another protocol, and its files are whole or not there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.sweep import Local, Store, run
from studies.preemption.folder import TRIALS, Held, gathered, read, write
from studies.preemption.jobs import sweep_of
from studies.preemption.protocol import Study
from tests.studies import small


def study(**changed: Any) -> Study:
    """Of 29 trials."""
    return small.study(**{"pairs": {"train": 2, "test": 2}} | changed)


class Killed(Exception):
    """Somebody has had enough."""


def swept(of: Study, folder: Path, units: int | None = None) -> None:
    """Sweep, or be killed after so many units of four trials."""
    sweep = sweep_of(of, tuple(of.hands))
    object.__setattr__(sweep, "unit", 4)
    seen: list[int] = []

    def told(done: int, total: int) -> None:
        seen.append(done)
        if units is not None and len(seen) > units:
            raise Killed

    run(sweep, Store(folder / TRIALS), Local(0), told)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("done")
    swept(study(), folder)
    write(read(folder), folder)
    return folder


@pytest.mark.slow
def test_killed_and_resumed_it_is_the_same_file(done: Path, tmp_path: Path) -> None:
    with pytest.raises(Killed):
        swept(study(), tmp_path, units=3)
    assert 0 < read(tmp_path).table.num_rows < read(done).table.num_rows
    swept(study(), tmp_path)
    write(read(tmp_path), tmp_path)
    assert (tmp_path / "trials.parquet").read_bytes() == (done / "trials.parquet").read_bytes()
    assert (tmp_path / "report.html").read_bytes() == (done / "report.html").read_bytes()


@pytest.mark.slow
def test_another_protocol_is_refused(done: Path) -> None:
    changed = study(seed=1)
    assert changed.digest != study().digest
    with pytest.raises(ConfigError, match=rf"is of another sweep: .*protocol {study().digest} there"):
        swept(changed, done)


@pytest.mark.slow
def test_a_manifest_that_somebody_changed_is_found_out(done: Path, tmp_path: Path) -> None:
    with pytest.raises(Killed):
        swept(study(), tmp_path, units=1)
    path = tmp_path / TRIALS / "manifest.json"
    content: dict[str, Any] = json.loads(path.read_text())
    content["data"]["study"]["analysis"]["margin"] = 0.3
    path.write_text(json.dumps(content))
    with pytest.raises(RecordingError, match="it was changed afterwards"):
        read(tmp_path)


def test_nothing_yet_is_a_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="nothing was swept into it"):
        read(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_report_needs_nothing_from_elsewhere_and_has_the_hash(done: Path) -> None:
    text = (done / "report.html").read_text()
    assert "http" not in text
    assert "<script" not in text
    assert "src=" not in text
    assert study().digest in text
    assert text.count("<svg") >= 4
    assert not [name for name in done.iterdir() if name.name.startswith(".")]


def test_the_hash_is_of_what_is_said_and_not_of_how() -> None:
    assert study().digest == study(version=1).digest
    assert study(version=2).digest != study().digest


@pytest.mark.slow
def test_hands_made_in_folders_of_their_own_are_one_study_and_the_last_made_counts(done: Path, tmp_path: Path) -> None:
    two = study(hands={"model_o": "model_o_{object}", "sih": "sih_{object}"})
    old, new = tmp_path / "old", tmp_path / "new"
    swept(two, old)
    sweep = sweep_of(two, ("sih",))
    run(sweep, Store(new / TRIALS), Local(0))
    once = gathered([old, new])
    assert repr(once.table.to_pylist()) == repr(read(old).table.to_pylist())  # NaN is no NaN.
    assert once.hands == {"model_o": 29, "sih": 29}
    write(gathered([old, new]), tmp_path / "out")
    assert sorted(each.name for each in (tmp_path / "out").iterdir()) == ["report.html", "trials.parquet"]
    again = gathered([tmp_path / "out", new])  # A written file is as good as what it was written of.
    assert repr(again.table.to_pylist()) == repr(once.table.to_pylist())
    with pytest.raises(ConfigError, match=rf"protocol {study().digest}, and .* has {two.digest}: .* no one study"):
        gathered([old, done])


@pytest.mark.slow
def test_a_hand_that_is_made_anew_takes_the_place_of_the_old_one(done: Path, tmp_path: Path) -> None:
    found = read(done)
    mended = found.table.set_column(
        found.table.column_names.index("held"), "held", [[not yes for yes in found.table["held"].to_pylist()]]
    )
    write(found._replace(table=mended), tmp_path)
    for folders, table in (([done, tmp_path], mended), ([tmp_path, done], found.table)):
        assert gathered(folders).table["held"].to_pylist() == table["held"].to_pylist()


def test_a_report_says_where_and_when_its_trials_were_made_if_somebody_does(tmp_path: Path) -> None:
    of = study()
    rate = dict.fromkeys(("P0", "P0e", "P25", "P50", "P75", "P90", "Pd", "Pc"), 0.8)
    table = pa.Table.from_pylist([row | {"key": str(k)} for k, row in enumerate(small.rows(of, rate))])
    held = Held(of, {"protocol": of.digest}, table)
    write(held, tmp_path / "plain")
    assert "made" not in (tmp_path / "plain" / "report.html").read_text().split("</header>")[0].split("<h1>")[1]
    write(held, tmp_path / "said", "on <a> computer")
    assert "made on &lt;a&gt; computer" in (tmp_path / "said" / "report.html").read_text()
    again = read(tmp_path / "said")
    assert again.study.digest == of.digest
    assert again.table.num_rows == table.num_rows
