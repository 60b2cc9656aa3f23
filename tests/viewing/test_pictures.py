"""Pictures and films show the right moments, the right way round, in the right colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast

import av
import numpy as np
import pytest
from PIL import Image

from allegro_twin.errors import ConfigError, HandFault, RecordingError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.types import Sample
from allegro_twin.viewing.camera import Camera, Picture
from allegro_twin.viewing.films import CONTAINERS, film, filmed, open_film
from allegro_twin.viewing.stills import overview, pictured
from tests.conftest import MakeSim
from tests.full_disk import full_disk
from tests.test_loop import samples_for

SIZE = 48


class Fade:
    """In the place of a camera: what it sees is red, and turns blue as time passes."""

    def __init__(self, times: Sequence[float]) -> None:
        self._times, self.now = times, 0.0

    def samples(self) -> Iterator[Sample]:
        for t, sample in zip(self._times, samples_for(list(self._times)), strict=True):
            self.now = t
            yield sample

    def take(self) -> Picture:
        picture = np.zeros((SIZE, SIZE, 3), dtype=np.uint8)
        picture[..., 0], picture[..., 2] = round(255 * (1 - self.now)), round(255 * self.now)
        return picture


def fade(seconds: float) -> Fade:
    return Fade([0.003 * k for k in range(round(seconds / 0.003) + 1)])


def consume(samples: Iterator[Sample]) -> int:
    return sum(1 for _ in samples)


def panes(path: Path) -> list[float]:
    """How far each pane of a strip has faded."""
    strip = np.asarray(Image.open(path))
    assert strip.shape[0] == SIZE
    return [float(strip[0, k, 2]) / 255 for k in range(0, strip.shape[1], SIZE)]


def test_a_film_has_thirty_frames_a_second_of_the_hands_time_and_its_colours(tmp_path: Path) -> None:
    scene = fade(0.9)
    assert consume(filmed(scene.samples(), cast(Camera, scene), tmp_path / "a.mp4")) == 301
    with av.open(str(tmp_path / "a.mp4")) as film:
        rate = film.streams.video[0].average_rate
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert (rate, len(frames)) == (30, 28)
    first, last = frames[0].mean(axis=(0, 1)), frames[-1].mean(axis=(0, 1))
    np.testing.assert_allclose(first, [255, 0, 0], atol=15)
    np.testing.assert_allclose(last, [25, 0, 230], atol=15)


def test_a_film_that_is_broken_off_is_not_there(tmp_path: Path) -> None:
    scene = fade(0.3)

    def breaks() -> Iterator[Sample]:
        yield from scene.samples()
        raise RuntimeError

    with pytest.raises(RuntimeError):
        consume(filmed(breaks(), cast(Camera, scene), tmp_path / "a.mp4"))
    assert list(tmp_path.iterdir()) == []


def frames_in(path: Path) -> int:
    with av.open(str(path)) as made:
        return sum(1 for _ in made.decode(video=0))


@pytest.mark.parametrize("end", [KeyboardInterrupt(), HandFault("index: too fast")])
def test_what_was_filmed_until_ctrl_c_or_a_fault_is_kept(end: BaseException, tmp_path: Path) -> None:
    scene = fade(0.3)

    def breaks() -> Iterator[Sample]:
        yield from scene.samples()
        raise end

    with pytest.raises(type(end)):
        consume(filmed(breaks(), cast(Camera, scene), tmp_path / "a.mp4"))
    assert frames_in(tmp_path / "a.mp4") == 10


def test_a_full_disk_does_not_stop_whoever_is_filmed_and_is_an_error_at_the_end(tmp_path: Path) -> None:
    noise, taken = np.random.default_rng(0), 0
    refused, path = pytest.raises(RecordingError, match="cannot write .*a.mp4: "), tmp_path / "a.mp4"
    with full_disk(20_000), refused, open_film(path) as add:
        while taken < 120:
            add(noise.integers(0, 255, (128, 128, 3), dtype=np.uint8))
            taken += 1
    assert taken == 120
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("moments", "expected"),
    [([0.6, 0.3], [0.3, 0.6]), ([], [0.9]), ([0.3, 5.0], [0.3, 0.9])],
    ids=["in order", "none: the end", "one that never came: the end"],
)
def test_a_strip_has_a_pane_for_every_moment(moments: list[float], expected: list[float], tmp_path: Path) -> None:
    scene = fade(0.9)
    consume(pictured(scene.samples(), cast(Camera, scene), tmp_path / "a.png", moments))
    assert panes(tmp_path / "a.png") == pytest.approx(expected, abs=0.005)


def test_an_overview_shows_the_second_pane_of_every_trial_row_by_row(tmp_path: Path) -> None:
    strips = {}
    for k in range(7):
        panes_ = [np.full((SIZE, SIZE, 3), value, dtype=np.uint8) for value in (0, 30 * (k + 1), 255)]
        strips[f"trial {k}"] = tmp_path / f"{k}.png"
        Image.fromarray(np.hstack(panes_[: 1 if k == 6 else 3])).save(strips[f"trial {k}"])
    overview(strips, tmp_path / "all.png")
    sheet = np.asarray(Image.open(tmp_path / "all.png"))
    assert sheet.shape == (480, 1440, 3)
    middles = sheet[120::240, 120::240, 0]
    np.testing.assert_array_equal(middles, [[30, 60, 90, 120, 150, 180], [0, 255, 255, 255, 255, 255]])
    assert (sheet[:30, 8:60] == 40).all(axis=-1).any()  # The name.


def test_the_left_hand_is_seen_from_the_mirrored_place_with_the_grasp_in_the_middle(make_sim: MakeSim) -> None:
    views = {}
    for side in ("right", "left"):
        backend = make_sim(load_spec(side=side))
        backend.reset()
        try:
            camera = Camera(backend, width=160, height=160)
        except ConfigError as error:
            pytest.skip(str(error))
        views[side] = camera.take().astype(float)
        camera.close()
    mirrored = np.abs(views["right"] - views["left"][:, ::-1]).mean()
    as_it_is = np.abs(views["right"] - views["left"]).mean()
    assert mirrored < 0.35 * as_it_is
    hand = np.abs(views["right"] - np.median(views["right"], axis=(0, 1))).sum(axis=2) > 60
    assert hand[60:100, 60:100].any()


def test_a_codec_that_fails_does_not_stop_whoever_is_filmed_and_is_an_error_at_the_end(tmp_path: Path) -> None:
    refused = pytest.raises(RecordingError, match="a.mp4: the codec failed .*is there enough memory")
    went_on = False
    with refused, open_film(tmp_path / "a.mp4") as add:
        add(np.zeros((2, 40_000, 3), dtype=np.uint8))  # Wider than H.264 has it.
        went_on = True
    assert went_on
    assert list(tmp_path.iterdir()) == []


def test_a_film_may_have_any_size_though_its_codec_wants_even_ones(tmp_path: Path) -> None:
    film((np.full((31, 41, 3), 200, dtype=np.uint8) for _ in range(3)), tmp_path / "odd.mp4", 30)
    with av.open(str(tmp_path / "odd.mp4")) as container:
        assert {(frame.width, frame.height) for frame in container.decode(video=0)} == {(42, 32)}


def test_an_overview_of_wide_pictures_shows_their_middle(tmp_path: Path) -> None:
    wide = np.zeros((SIZE, 2 * SIZE, 3), dtype=np.uint8)
    wide[:, SIZE // 2 : -SIZE // 2] = 200
    scene = fade(0.3)
    scene.take = lambda: wide  # type: ignore[method-assign]  # A wider camera.
    consume(pictured(scene.samples(), cast(Camera, scene), tmp_path / "a.png", [0.1, 0.2]))
    overview({"wide": tmp_path / "a.png"}, tmp_path / "all.png")
    sheet = np.asarray(Image.open(tmp_path / "all.png"))
    assert (sheet[60:, 2:238] == 200).all()


def test_films_are_of_the_kind_that_their_suffix_names_and_of_no_other_kind(tmp_path: Path) -> None:
    for suffix in CONTAINERS:
        film([np.zeros((32, 32, 3), dtype=np.uint8)] * 3, tmp_path / f"a{suffix}", 30)
        with av.open(str(tmp_path / f"a{suffix}")) as made:
            assert suffix[1:] in made.format.extensions
    with pytest.raises(ConfigError, match=r"a.gif: a film ends in .mp4 or .mkv or .mov"):
        film([], tmp_path / "a.gif", 30)
