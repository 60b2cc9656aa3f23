"""A folder of pictures with poses is calibrated as the simulated arm is, and what is wrong with it is one line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from allegro_twin.cell.calibration.pattern import PatternSettings
from allegro_twin.cell.calibration.pictures import FILE, POSES, ArmPicture, calibrate_folder, write_folder
from allegro_twin.cell.calibration.simulated import CalibrationCell
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.kinematics.orientation import angle_between
from allegro_twin.kinematics.pose import Pose
from tests.surfaces.cli.conftest import Run, command

__all__ = ["command"]  # The command line in this process, as a fixture.


def calibration_cell(config: str) -> CalibrationCell:
    try:
        return CalibrationCell(
            load_settings(LabSettings, data_root() / f"conf/{config}.yaml"), PatternSettings(), seed=1
        )
    except ConfigError as error:
        if "cannot render" in str(error):
            pytest.skip(str(error))
        raise


@pytest.fixture(scope="module")
def wrist(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pose]:
    """A folder of eight pictures by a camera at the wrist, and where that really is on the flange."""
    folder, cell = tmp_path_factory.mktemp("pictures"), calibration_cell("lab_allegro_wrist")
    try:
        taken = [cell.teleport(at, f"{k:02d}.png") for k, at in enumerate(cell.postures(8))]
        write_folder(folder, taken, cell.pattern, cell.lens)
        return folder, cell.truth
    finally:
        cell.close()


@pytest.mark.slow
def test_the_camera_is_found_from_the_folder_within_its_stated_error(wrist: tuple[Path, Pose]) -> None:
    folder, truth = wrist
    done = calibrate_folder(folder, at_the_wrist=True)
    far = np.linalg.norm(done.camera.position - truth.position)
    turned = angle_between(done.camera.rotation, truth.rotation)
    assert far < done.found.position_error < 1e-3
    assert turned < done.found.rotation_error < np.radians(0.15)
    assert done.unseen == ()


def changed(folder: Path, into: Path, **keys: object) -> Path:
    """The folder's calibration.yaml with other keys, beside the same pictures; None takes a key out."""
    content = yaml.safe_load((folder / FILE).read_text()) | keys
    for path in folder.glob("*.png"):
        (into / path.name).write_bytes(path.read_bytes())
    (into / FILE).write_text(yaml.safe_dump({key: value for key, value in content.items() if value is not None}))
    return into


@pytest.mark.slow
def test_a_table_of_poses_says_the_same_as_a_list_of_views(wrist: tuple[Path, Pose], tmp_path: Path) -> None:
    views = yaml.safe_load((wrist[0] / FILE).read_text())["views"]
    folder = changed(wrist[0], tmp_path, views=None, poses="poses.csv")
    rows = [",".join(map(str, [view["picture"], *view["position"], *view["quaternion"]])) for view in views]
    table = "\n".join([", ".join(POSES), *rows]) + "\n"
    (folder / "poses.csv").write_text(table, encoding="utf-8-sig")  # As Excel does.
    one, other = (calibrate_folder(each, at_the_wrist=True) for each in (wrist[0], folder))
    np.testing.assert_array_equal(one.camera.position, other.camera.position)


@pytest.mark.slow
def test_a_depth_camera_beside_the_one_of_the_pictures_is_placed_by_its_place(
    wrist: tuple[Path, Pose], tmp_path: Path
) -> None:
    beside = {"position": [-0.015, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0]}
    done = calibrate_folder(changed(wrist[0], tmp_path, depth_camera=beside), at_the_wrist=True)
    x = done.found.camera.rotation[:, 0]
    np.testing.assert_allclose(done.camera.position, done.found.camera.position - 0.015 * x, atol=1e-12)


def test_a_picture_that_is_listed_twice_is_refused_by_its_name(wrist: tuple[Path, Pose], tmp_path: Path) -> None:
    views = yaml.safe_load((wrist[0] / FILE).read_text())["views"]
    folder = changed(wrist[0], tmp_path, views=[*views, views[2]])
    with pytest.raises(ConfigError, match=r"02\.png is listed twice: a picture counts once; leave one out"):
        calibrate_folder(folder, at_the_wrist=True)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"views": None}, "give the arm's poses either as `views` or as a table of `poses`"),
        ({"views": [{"picture": "99.png", "position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}]}, "no picture .*99.png"),
        ({"views": [{"picture": "00.png", "position": [0, 0, 0], "quaternion": [1, 1, 0, 0]}]}, "has length 1.41"),
        ({"views": None, "poses": "none.csv"}, r"none\.csv: cannot be read as a table"),
        ({"intrinsics": {"width": 640, "height": 480, "fx": 384, "fy": 384, "cx": 320, "cy": 240,
                         "distortion": [0.1]}}, "distortion has 1 numbers; OpenCV takes 4, 5, 8, 12 or 14"),
        ({"pattern": {"dictionary": "DICT_6X6_50"}}, "0 pictures show the pattern"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_folder_is_one_line(
    wrist: tuple[Path, Pose], tmp_path: Path, keys: dict[str, object], said: str
) -> None:
    with pytest.raises(ConfigError, match=said) as error:
        calibrate_folder(changed(wrist[0], tmp_path, **keys), at_the_wrist=True)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("picture,x,y,z,qw,qx,qy\n00.png,0,0,0,1,0,0\n", r"poses\.csv: no column 'qz'"),
        (",".join(POSES) + "\n00.png,0,0,a,1,0,0,0\n", r"poses\.csv:2: could not convert string to float"),
        (",".join(POSES) + "\n00.png,0,0,0,2,0,0,0\n", r"poses\.csv:2: .*length 2"),
        (",".join(POSES) + "\n00.png,0,0\n", r"poses\.csv:2: has 3 values; the first line has 8 names"),
        (",".join(POSES) + "\n\n00.png,0,0\n", r"poses\.csv:3: has 3 values"),
        (";".join(POSES) + "\n", r"poses\.csv: no column 'picture'; it needs .*, and has picture;x;y;z"),
    ],
)
def test_what_is_wrong_with_a_table_is_one_line(wrist: tuple[Path, Pose], tmp_path: Path, text: str, said: str) -> None:
    folder = changed(wrist[0], tmp_path, views=None, poses="poses.csv")
    (folder / "poses.csv").write_text(text)
    with pytest.raises(ConfigError, match=said) as error:
        calibrate_folder(folder, at_the_wrist=True)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"no picture", b""])
def test_a_file_that_is_no_picture_is_refused(wrist: tuple[Path, Pose], tmp_path: Path, content: bytes) -> None:
    folder = changed(wrist[0], tmp_path)
    (folder / "00.png").write_bytes(content)
    with pytest.raises(ConfigError, match=r"00\.png is no picture that OpenCV reads"):
        calibrate_folder(folder, at_the_wrist=True)


def test_the_command_writes_the_mount_that_a_cells_config_takes(
    wrist: tuple[Path, Pose], tmp_path: Path, command: Run
) -> None:
    code, shown, _ = command("lab-calibrate", "lab_allegro_wrist", "--pictures", wrist[0], "--out", tmp_path / "found")
    assert code == 0
    assert "the camera is known within 0." in shown
    mount = yaml.safe_load((tmp_path / "found/mount.yaml").read_text())["mount"]
    config = yaml.safe_load((data_root() / "conf/lab_allegro_wrist.yaml").read_text())
    settings = LabSettings.model_validate(config | {"camera": {**config["camera"], "mount": mount}})
    assert settings.at_the_wrist
    np.testing.assert_allclose(settings.camera.mount.local().position, wrist[1].position, atol=1e-3)


def test_the_command_names_a_picture_that_does_not_show_the_pattern(
    wrist: tuple[Path, Pose], tmp_path: Path, command: Run
) -> None:
    folder = changed(wrist[0], tmp_path)
    (folder / "03.png").write_bytes(blank())
    code, _, complaint = command("lab-calibrate", "lab_allegro_wrist", "--pictures", folder)
    assert code == 0
    assert "03.png: shows too little of the pattern; left out" in complaint


def blank() -> bytes:
    cv2 = pytest.importorskip("cv2")
    return bytes(cv2.imencode(".png", np.zeros((480, 640), np.uint8))[1].tobytes())


def test_the_command_writes_a_pattern_to_print(tmp_path: Path, command: Run) -> None:
    code, shown, _ = command("lab-calibrate", "lab_allegro", "--pattern", tmp_path / "pattern.png")
    assert code == 0
    assert "its 7 squares are 245 mm wide" in shown
    assert (tmp_path / "pattern.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_without_a_description_is_refused(tmp_path: Path, command: Run) -> None:
    code, _, complaint = command("lab-calibrate", "lab_allegro", "--pictures", tmp_path)
    assert code == 2
    assert "calibration.yaml" in complaint


@pytest.mark.slow
@pytest.mark.parametrize("config", ["lab_allegro_wrist", "lab_allegro"])
def test_the_simulated_arm_drives_to_every_posture_and_finds_its_camera(config: str) -> None:
    from allegro_twin.cell.calibration.pictures import calibrate_pictures

    cell = calibration_cell(config)
    try:
        taken: list[ArmPicture] = list(cell.take(cell.postures(10)))
        found, _ = calibrate_pictures(taken, cell.pattern, cell.lens, np.zeros(0), at_the_wrist=cell.at_the_wrist)
        assert np.linalg.norm(found.camera.position - cell.truth.position) < found.position_error < 1e-3
        assert angle_between(found.camera.rotation, cell.truth.rotation) < found.rotation_error < np.radians(0.15)
        mount = cell.mount(found.camera)
        assert mount.body == ("fer_flange" if cell.at_the_wrist else None)
    finally:
        cell.close()


@pytest.mark.slow
def test_a_folder_whose_square_is_wrong_says_which_squares_the_pictures_fit(
    wrist: tuple[Path, Pose], tmp_path: Path
) -> None:
    smaller = {"kind": "charuco", "columns": 7, "rows": 5, "square": 0.032, "marker": 0.0237}
    done = calibrate_folder(changed(wrist[0], tmp_path, pattern=smaller), at_the_wrist=True)
    assert re.search(
        r"the pictures fit squares of (34\.9\d|35\.0\d) mm, and `square` says 32: measure it", done.warning
    )
    assert np.linalg.norm(done.camera.position - wrist[1].position) < done.found.position_error


def test_a_folder_whose_principal_point_is_wrong_says_which_one_the_pictures_fit(
    wrist: tuple[Path, Pose], tmp_path: Path
) -> None:
    lens = yaml.safe_load((wrist[0] / FILE).read_text())["intrinsics"]
    done = calibrate_folder(changed(wrist[0], tmp_path, intrinsics=lens | {"cy": lens["cy"] - 8.0}), at_the_wrist=True)
    said = re.search(
        r"a principal point at ([\d.]+), ([\d.]+), and `cx`, `cy` say 319.5, 228.4: measure it", done.warning
    )
    assert said is not None
    np.testing.assert_allclose([float(each) for each in said.groups()], [lens["cx"], lens["cy"]], atol=1.0)
