"""A user's library: find by name and filter, add, delete, store; whatever is wrong, the file is as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import data_root, parse_yaml
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import (
    GraspFile,
    PostureFile,
    convert_side,
    joint_values,
    parse_entry,
    posture_entry,
    trajectory_entry,
)
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import Library, load_grasp, load_posture
from allegro_twin.hands.library.taxonomy import ClaimedType, claim_observed
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array

RIGHT, LEFT = load_spec(side="right"), load_spec(side="left")
WITHIN = st.lists(st.floats(0.0, 1.0), min_size=16, max_size=16).map(
    lambda parts: RIGHT.lower + np.array(parts) * (RIGHT.upper - RIGHT.lower)
)
QUADPOD = (data_root() / "conf" / "grasps" / "quadpod.yaml").read_text()
MINE = """\
# Taught on a Tuesday.   Spaces   stay.

entries:
  # Says hello,
  # slowly.
  wave:
    kind: posture   # not a motion yet
    description: "Hello"
    side: right
    angles:
      index:  [0.0, 0.10, 0.2, 0.3]   # the finger that greets
      middle: [0.0, 0.1, 0.2, 0.3]
      ring: [0.0, 0.1, 0.2, 0.3]
      thumb: [0.5, 0.1, 0.2, 0.3]
  # Between the two.

  "off_duty":   {kind: posture, angles: {index: [0, 0, 0, 0], middle: [0,0,0,0],
      ring: [0, 0, 0, 0],   thumb: [0.5, 0, 0, 0]}}
# The end.
"""


def _read(text: str) -> dict[str, Any]:
    return parse_yaml(text, "it")


def test_what_a_reader_of_a_file_changes_no_other_reader_sees() -> None:
    _read(MINE)["entries"]["wave"]["angles"]["index"].clear()
    assert _read(MINE)["entries"]["wave"]["angles"]["index"] == [0.0, 0.1, 0.2, 0.3]


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(MINE)
    return path


def same_bits(a: Array, b: Array) -> bool:
    return np.asarray(a).tobytes() == np.asarray(b).tobytes()


def test_what_ships_and_what_is_mine_is_found_by_name(mine: Path, spec: HandSpec) -> None:
    library = Library(mine)
    np.testing.assert_array_equal(library.posture("wave", spec)[:4], [0.0, 0.1, 0.2, 0.3])
    assert isinstance(library.get("quadpod", spec), Grasp)
    np.testing.assert_array_equal(np.asarray(library.get("home", spec)), load_posture("home", spec))
    for ask, message in (
        (lambda: library.get("wav", spec), "no entry named 'wav'; did you mean 'wave'"),
        (lambda: library.posture("hone", spec), "no posture named 'hone'; did you mean 'home'"),
        (lambda: library.grasp("home", spec), "'home' is a posture, not a grasp"),
        (lambda: library.posture(mine, spec), "holds `entries`"),
        (lambda: Library("nowhere"), "there is no file or folder nowhere"),
    ):
        with pytest.raises(ConfigError, match=message):
            ask()


def test_a_folder_named_library_is_used_where_there_is_one(
    mine: Path, spec: HandSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mine.parent)
    with pytest.raises(ConfigError, match="no posture named 'wave'"):
        load_posture("wave", spec)
    (mine.parent / "library" / "deep").mkdir(parents=True)
    mine.rename(mine.parent / "library" / "deep" / "mine.yaml")
    (mine.parent / "library" / ".left.123.yaml").write_text("half a fi")
    assert load_posture("wave", spec).shape == (16,)
    single = mine.parent / "library" / "salute.yaml"
    single.write_text("angles: {index: [0, 0, 0, 0], middle: [0, 0, 0, 0], ring: [0, 0, 0, 0], thumb: [1, 0, 0, 0]}\n")
    assert load_posture("salute", spec)[12] == 1.0


def names(**filters: Any) -> set[str]:
    return {listed.name for listed in Library().list(**filters)}


def test_every_filter_narrows_the_list() -> None:
    everything = names()
    assert {"home", "quadpod"} <= everything
    kinds = [names(kind=kind) for kind in ("posture", "grasp", "trajectory")]
    assert set().union(*kinds) == everything
    assert sum(map(len, kinds)) == len(everything)
    assert names(taxonomy=27) == names(taxonomy="quadpod") >= {"sphere_4_finger", "precision_disk"}
    assert names(taxonomy="power") | names(taxonomy="precision") | names(taxonomy="intermediate") <= names(kind="grasp")
    assert "sphere_4_finger" not in names(taxonomy="power")
    assert "quadpod" in names(fingers=4)
    assert "quadpod" not in names(fingers=3)
    assert "quadpod" in names(object_size=0.062)
    assert "quadpod" not in names(object_size=0.075)
    assert {"tripod_lemon", "prismatic_3_finger_cube"} <= names(object_size=(0.053, 0.058), kind="grasp")
    assert "sphere_4_finger" in names(taxonomy="quadpod", object_size=(0.06, 0.066))
    assert "sphere_4_finger" not in names(taxonomy="quadpod", object_size=(0.2, 0.3))


def test_a_filter_by_type_goes_by_what_was_observed_and_not_by_the_name() -> None:
    """`quadpod` was drawn as one; its contacts show another grasp."""
    assert "large_diameter" not in names(taxonomy="Large Diameter")
    assert "precision_sphere" not in names(taxonomy=13)
    assert "precision_sphere" in names(taxonomy="Inferior Pincer")


def test_no_grasp_that_ships_claims_what_its_contacts_do_not_show() -> None:
    for listed in Library().list("grasp"):
        entry = listed.entry
        assert isinstance(entry, GraspFile)
        if entry.observed is not None:
            assert entry.taxonomy == claim_observed(entry.observed) or entry.taxonomy.number == entry.observed.number
        else:
            assert not entry.evidence or entry.evidence.startswith("posture: "), listed.name


def test_a_claim_is_one_of_the_paper() -> None:
    for wrong in ({"number": 26, "name": "Quadpod", "type": "power", "opposition": "pad"},
                  {"number": 26, "name": "Sphere 4 Finger", "type": "precision", "opposition": "pad"},
                  {"number": None, "name": "Ring"}):  # fmt: skip
        with pytest.raises(ValidationError, match="type 26 has the|a grasp without a number"):
            ClaimedType.model_validate(wrong)


def test_a_filter_that_nothing_can_have_says_so() -> None:
    with pytest.raises(ConfigError, match="no taxonomy named 'quadpot'; did you mean 'Quadpod'"):
        names(taxonomy="quadpot")
    with pytest.raises(ConfigError, match="1 to 33, not 34"):
        names(taxonomy=34)
    with pytest.raises(ConfigError, match="no kind named 'gras'; did you mean 'grasp'"):
        names(kind="gras")


def test_both_hands_have_every_entry_and_a_tighter_hand_has_fewer(side: Side) -> None:
    from dataclasses import replace

    hand = load_spec(side=side)
    assert names(hand=hand) == {listed.name for listed in Library().list() if listed.entry.hand == "allegro"}
    tight = replace(hand, upper=np.minimum(hand.upper, 1.0))
    assert "fist" not in names(hand=tight)
    assert "open" in names(hand=tight)


@given(WITHIN, st.sampled_from([(RIGHT, LEFT), (LEFT, RIGHT)]))
def test_the_mirror_of_a_posture_is_exact_and_its_own_inverse(
    position: Array, hands: tuple[HandSpec, HandSpec]
) -> None:
    one, other = hands
    entry = posture_entry(position, one)
    mirrored = joint_values(entry, other, "it")["angles"]
    assert same_bits(mirrored, one.mirror_posture(position))
    rewritten = convert_side(entry, one, other.side, "it")
    assert rewritten.side == other.side
    for hand in hands:
        assert same_bits(joint_values(entry, hand, "")["angles"], joint_values(rewritten, hand, "")["angles"])


@given(st.lists(WITHIN, min_size=2, max_size=5))
def test_the_mirror_of_a_trajectory_is_exact_row_by_row(positions: list[Array]) -> None:
    entry = trajectory_entry(np.arange(len(positions)), np.array(positions), LEFT)
    np.testing.assert_array_equal(joint_values(entry, RIGHT, "")["positions"], LEFT.mirror_posture(np.array(positions)))
    assert convert_side(convert_side(entry, LEFT, "right", ""), RIGHT, "left", "") == entry


def test_storing_for_the_left_changes_the_entry_whose_file_is_for_the_right(mine: Path) -> None:
    library = Library(mine)
    position = load_posture("scissors", LEFT).copy()
    position[0] = 0.0  # The file has 0.0 for the right, whose mirror image is -0.0.
    library.add("wave", posture_entry(position, LEFT), LEFT)
    library.store("wave", mine)
    assert mine.read_text().count("side:") == 1
    assert "side: right" in mine.read_text()
    fresh = Library(mine)
    assert same_bits(fresh.posture("wave", LEFT), position)
    assert same_bits(fresh.posture("wave", RIGHT), LEFT.mirror_posture(position))
    assert [listed.name for listed in fresh.list()].count("wave") == 1


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("tiny", [1e-5, -1.5e-7, 5e-324, 0.1 + 0.2 - 0.3, 1 / 3, -0.0])
def test_a_file_gives_back_every_bit(tmp_path: Path, tiny: float, side: Side) -> None:
    hand = load_spec(side=side)
    position = load_posture("open", hand).copy()
    position[:4] = tiny
    for name in ("a", "b", "a"):  # New in a new file, new beside another, in place of itself.
        library = Library(tmp_path)
        library.add(name, posture_entry(position, hand), hand)
        library.store(name, tmp_path / "mine.yaml")
        assert same_bits(Library(tmp_path).posture(name, hand), position)


def test_what_is_added_is_there_until_it_is_deleted_and_no_file_knows(tmp_path: Path, spec: HandSpec) -> None:
    library = Library(tmp_path)
    library.add("curl", posture_entry(load_posture("rock", spec), spec, "Curled"), spec)
    np.testing.assert_array_equal(library.posture("curl", spec), load_posture("rock", spec))
    assert [listed.path for listed in library.list() if listed.name == "curl"] == [None]
    assert list(tmp_path.iterdir()) == []
    library.delete("curl")
    with pytest.raises(ConfigError, match="no entry named 'curl'"):
        library.get("curl", spec)
    with pytest.raises(ConfigError, match="no entry named 'curl'"):
        library.delete("curl")


def test_a_stored_entry_is_deleted_only_when_that_is_said_and_what_ships_never(mine: Path, spec: HandSpec) -> None:
    library = Library(mine)
    library.add("wave", posture_entry(load_posture("open", spec), spec), spec)
    library.delete("wave")  # The one in memory; the one in the file is back.
    assert library.posture("wave", spec)[1] == 0.1
    with pytest.raises(ConfigError, match="'wave' is stored in .*mine.yaml; to delete it there"):
        library.delete("wave")
    assert mine.read_text() == MINE
    library.delete("wave", from_file=True)
    begin, end = MINE.index("  wave:"), MINE.index("  # Between")
    assert mine.read_text() == MINE[:begin] + MINE[end:]
    library.delete("off_duty", from_file=True)
    assert Library(mine).list() == Library().list()
    for from_file in (True, False):
        with pytest.raises(ConfigError, match="'home' ships with the package"):
            library.delete("home", from_file=from_file)
    assert load_posture("home", spec).shape == (16,)


def test_every_byte_around_the_changed_entry_stays(mine: Path, spec: HandSpec) -> None:
    library = Library(mine)
    library.add("wave", posture_entry(load_posture("rock", spec), spec), spec)
    library.store("wave", mine)
    text = mine.read_text()
    begin, end = MINE.index("  wave:"), MINE.index("  # Between")
    assert text.startswith(MINE[:begin])
    assert text.endswith(MINE[end:])
    changed = text[begin : len(text) - len(MINE[end:])]
    for kept in ("# not a motion yet", '"Hello"', "# the finger that greets"):
        assert kept in changed
    np.testing.assert_array_equal(Library(mine).posture("wave", spec), load_posture("rock", spec))


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_new_entry_goes_below_the_last_and_nothing_else_moves(mine: Path, spec: HandSpec, end: str) -> None:
    before = MINE.replace("\n", end).encode()
    mine.write_bytes(before)
    library = Library(mine)
    library.add("yes", posture_entry(load_posture("rock", spec), spec), spec)  # YAML 1.1 reads a bare yes as True.
    library.store("yes", mine)
    after, tail = mine.read_bytes(), f"# The end.{end}".encode()
    assert after.startswith(before.removesuffix(tail))
    assert after.endswith(tail)
    assert end == "\n" or after.count(b"\n") == after.count(b"\r\n")
    np.testing.assert_array_equal(Library(mine).posture("yes", spec), load_posture("rock", spec))
    assert Library(mine).posture("off_duty", spec)[12] == 0.5


@pytest.mark.parametrize(
    "text",
    [
        None,
        "",
        "# only a comment\n",
        "# no line end",
        "---\n# behind a mark\n",
        "entries:\n",
        "entries: {}  # none yet\n",
    ],
)
def test_a_file_that_is_new_or_empty_takes_its_first_entry(tmp_path: Path, spec: HandSpec, text: str | None) -> None:
    path = tmp_path / "deep" / "new.yaml"
    if text is not None:
        path.parent.mkdir()
        path.write_text(text)
    library = Library(tmp_path)
    for name in ("a", "b"):
        library.add(name, load_entry("fist"), spec)
        library.store(name, path)
    assert all(part in path.read_text() for part in (text or "").split("#")[1:])
    fresh = Library(path)
    np.testing.assert_array_equal(fresh.posture("a", spec), fresh.posture("b", spec))


def load_entry(name: str) -> PostureFile:
    return posture_entry(load_posture(name, RIGHT), RIGHT)


def test_a_file_of_one_entry_keeps_its_comments_when_it_changes(tmp_path: Path, spec: HandSpec) -> None:
    source = QUADPOD
    path = tmp_path / "my_quadpod.yaml"
    path.write_text("# Mine, from the shipped one.\n" + source)
    library = Library(tmp_path)
    grasp = parse_entry({**_read(source), "speed": 0.25}, "it")
    library.add("my_quadpod", grasp, spec)
    library.store("my_quadpod", path)
    assert path.read_text().startswith("# Mine, from the shipped one.\n")
    assert "# m; ellipsoid" in path.read_text()
    assert Library(path).grasp("my_quadpod", spec).speed == 0.25
    np.testing.assert_array_equal(Library(path).grasp("my_quadpod", spec).squeeze, load_grasp("quadpod", spec).squeeze)
    library.add("other", grasp, spec)
    with pytest.raises(ConfigError, match="holds one entry, 'my_quadpod'; store 'other' in another file"):
        library.store("other", path)
    library.delete("my_quadpod", from_file=True)
    assert not path.exists()


def test_a_taught_trajectory_is_stored_and_played_on_either_hand(tmp_path: Path, side: Side) -> None:
    rows = np.array([load_posture(name, RIGHT) for name in ("open", "rock", "paper")])
    library = Library(tmp_path)
    library.add("game", trajectory_entry([0.2, 0.7, 1.5], rows, RIGHT, "As shown"), RIGHT)
    library.store("game", tmp_path / "shown.yaml")
    hand = load_spec(side=side)
    motion = Library(tmp_path).trajectory("game", hand)
    assert isinstance(Library(tmp_path).get("game", hand), TaughtMotion)
    expected = rows if side == "right" else RIGHT.mirror_posture(rows)
    np.testing.assert_array_equal(motion.positions, expected)
    assert motion.seconds == pytest.approx(1.3)
    start = load_posture("home", hand)
    path = motion.reference(speed=0.5).begin(start)
    lead = path.seconds - motion.seconds  # The way to the first position.
    np.testing.assert_array_equal(path(0.0).position, start)
    for t, row in zip((0.0, 0.5, 1.3), expected, strict=True):
        np.testing.assert_allclose(path(lead + t).position, row, atol=1e-12)
    np.testing.assert_allclose(path(lead + 0.25).position, (expected[0] + expected[1]) / 2, atol=1e-12)


def wrong(content: dict[str, Any]) -> Any:
    return lambda library: library.add("bad", parse_entry(content, "bad"), RIGHT)


HOME = {name: [0.0, 0.0, 0.0, 0.0] for name in ("index", "middle", "ring")} | {"thumb": [0.5, 0.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (wrong({"angles": HOME | {"index": [0.0, 1.71, 0.0, 0.0]}}), "bad: angles: index_1 = 1.7100 rad is 0.1"),
        (wrong({"angles": HOME | {"index": [0.0, 0.0, 0.0]}}), "index has 4 joints, not 3"),
        (wrong({"angles": {"index": [0.0] * 4}}), "middle, ring, thumb missing: give the angles of every finger, rad"),
        (wrong({"angles": {**HOME, "pinky": [0.0] * 4}}), "no finger named 'pinky'"),
        (wrong({"angels": HOME}), "bad: kind: missing; it is one of posture, grasp, trajectory"),
        (wrong({"kind": "posure", "angles": HOME}), "no kind named 'posure'; did you mean 'posture'"),
        (wrong({"times": [0.0, 0.0], "positions": [[0.0] * 16] * 2}), "times must ascend; 0 s comes after 0 s"),
        (wrong({"times": [0.0, 1.0], "positions": [[0.3] * 16, [0.3] * 15]}), r"positions\[1\] needs .* it has 15"),
        (wrong({"times": [0.0, 1.0], "positions": [[0.3] * 16]}), "2 times and 1 positions: each needs the other"),
        (
            lambda lib: trajectory_entry([0, 1], [[0.3] * 16, [0.5] * 16], RIGHT),
            r"positions\[1\]: index_0 = 0.5000 rad",
        ),
        (
            wrong({**_read(QUADPOD), "object_size": [0.06, 0.05]}),
            r"object_size: the smallest width comes first, not \[0.06, 0.05\]",
        ),
        (lambda lib: lib.add("bad", posture_entry(np.zeros(15), RIGHT), RIGHT), "needs one value or 16.* it has 15"),
        (lambda lib: lib.add("bad", posture_entry(np.full(16, 9.0), RIGHT), RIGHT), "outside its limits"),
        (lambda lib: lib.add("home", load_entry("rock"), RIGHT), "'home' ships with the package"),
        (lambda lib: lib.add("Bad-Name", load_entry("rock"), RIGHT), "a name is small letters"),
        (lambda lib: lib.store("wavy", "x.yaml"), "nothing to store: no added entry named 'wavy'"),
        (lambda lib: lib.posture("wavy", RIGHT), "no posture named 'wavy'; did you mean 'wave'"),
    ],
)
def test_a_bad_entry_is_refused_and_the_file_is_bit_identical(mine: Path, act: Any, message: str) -> None:
    library = Library(mine)
    with pytest.raises(ConfigError, match=message) as caught:
        act(library)
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError):
        library.store("bad", mine)
    assert mine.read_bytes() == MINE.encode()
    assert [path.name for path in mine.parent.iterdir()] == ["mine.yaml"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("0.3]   # the", "0.3   # the"), r"mine.yaml:\d+: not valid YAML"),
        (("0.10,", "0.1O,"), "mine.yaml:11: wave: angles.index.1: input should be a valid number, .* not '0.1O'"),
        (("side: right", "side: rihgt"), "mine.yaml:9: wave: side: input should be 'right' or 'left', not 'rihgt'"),
        (("angles:\n", "angels:\n"), "mine.yaml:10: wave: angels: unknown key; did you mean 'angles'"),
        (('"off_duty":', "off:"), "mine.yaml: entries: YAML reads this name as False; write it in quotes"),
        (('"off_duty":', "wave:"), r"mine.yaml:\d+: not valid YAML: key 'wave' is given twice"),
        (('"off_duty":', "home:"), "mine.yaml: 'home' ships with the package; choose another name"),
        (("entries:", "entrys:"), "mine.yaml:1: kind: missing"),
    ],
)
def test_a_file_with_a_mistake_is_one_clear_line_and_stays_as_it_is(
    mine: Path, spec: HandSpec, change: tuple[str, str], message: str
) -> None:
    text = MINE.replace(*change, 1)
    mine.write_text(text)
    library = Library(mine)
    library.add("new", load_entry("rock"), spec)
    for act in (library.list, lambda: library.get("off_duty", spec), lambda: library.store("new", mine)):
        with pytest.raises(ConfigError, match=message) as caught:
            act()
        assert "\n" not in str(caught.value)
    assert mine.read_text() == text
    assert library.posture("home", spec).shape == (16,)  # What ships does not depend on it.


def test_a_name_has_one_place_and_what_ships_is_not_written(mine: Path, spec: HandSpec) -> None:
    library = Library(mine.parent)
    library.add("wave", load_entry("rock"), spec)
    with pytest.raises(ConfigError, match="'wave' is in .*mine.yaml already"):
        library.store("wave", mine.with_name("other.yaml"))
    assert not mine.with_name("other.yaml").exists()
    with pytest.raises(ConfigError, match="what ships with the package is not changed"):
        library.store("wave", data_root() / "conf" / "postures" / "home.yaml")
    with pytest.raises(ConfigError, match=r"ends in \.yaml"):
        library.store("wave", mine.with_suffix(".txt"))
    mine.with_name("other.yaml").write_text(MINE)
    with pytest.raises(ConfigError, match="is also in"):
        library.list()


def test_a_name_on_a_hands_card_is_not_hidden_by_an_entry_that_it_would_never_find(mine: Path, spec: HandSpec) -> None:
    own = replace(spec, postures={"clench": load_posture("rock", spec)})
    library = Library(mine)
    with pytest.raises(ConfigError, match="'clench' of a .* is the hand's own and stays as it is"):
        library.add("clench", load_entry("open"), own)
    with pytest.raises(ConfigError, match="'clench' of a .* is the hand's own and stays as it is"):
        library.check_store("clench", mine, own)
    assert library.check_store("clench", mine, spec) is None


def test_a_link_stays_a_link_and_its_file_keeps_its_permissions(mine: Path, spec: HandSpec) -> None:
    mine.chmod(0o640)
    link = mine.with_name("link.yaml")
    link.symlink_to(mine)
    library = Library(link)
    library.add("new", load_entry("rock"), spec)
    library.store("new", link)
    assert link.is_symlink()
    assert mine.stat().st_mode & 0o777 == 0o640
    assert Library(mine.parent).posture("new", spec).shape == (16,)


def test_a_place_that_cannot_be_written_is_an_error_and_the_entry_is_kept(tmp_path: Path, spec: HandSpec) -> None:
    (tmp_path / "file").write_text("")
    library = Library(tmp_path)
    library.add("new", load_entry("rock"), spec)
    with pytest.raises(RecordingError, match="cannot write .*new.yaml"):
        library.store("new", tmp_path / "file" / "new.yaml")
    assert library.posture("new", spec).shape == (16,)


def test_an_entry_that_shares_lines_with_another_is_left_to_a_person(mine: Path, spec: HandSpec) -> None:
    text = "entries: {a: {angles: &x {index: [0,0,0,0], middle: [0,0,0,0], ring: [0,0,0,0], thumb: [1,0,0,0]}},\n"
    text += " b: {angles: *x}}\n"
    mine.write_text(text)
    library = Library(mine)
    library.add("b", load_entry("rock"), spec)
    with pytest.raises(ConfigError, match=r"mine.yaml.*"):
        library.store("b", mine)
    assert mine.read_text() == text
