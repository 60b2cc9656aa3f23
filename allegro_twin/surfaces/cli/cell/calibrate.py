"""The command `lab-calibrate`: where the camera of a cell is, by pictures of a calibration pattern."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.cell.calibration.hand_eye import HandEyeCalibration
    from allegro_twin.cell.calibration.simulated import CalibrationCell
    from allegro_twin.cell.camera.mount import CameraMount
    from allegro_twin.cell.settings import LabSettings

MOUNT = "mount.yaml"
"""The file with the camera's mount, in the folder of --out."""
_FINE = 300  # Pixels a square of a pattern that is printed.


def lab_calibrate(
    config: Annotated[Path, typer.Argument(help="Config of a cell, such as conf/lab_allegro.yaml.")],
    pictures: Annotated[
        Path | None, typer.Option(help="Folder of pictures with a calibration.yaml; default: simulate.")
    ] = None,
    postures: Annotated[int, typer.Option(min=6, max=100, help="Postures of the simulated arm.")] = 15,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated postures and noise.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for mount.yaml, and for simulated pictures.", callback=options.folder),
    ] = None,
    pattern: Annotated[
        Path | None,
        typer.Option(help="Write the pattern to print, a PNG; replaces it, and ends.", callback=options.file(".png")),
    ] = None,
) -> None:
    """Find the mount of a cell's camera (hand-eye calibration)."""
    from allegro_twin.cell.settings import LabSettings
    from allegro_twin.files.assets import find_file
    from allegro_twin.files.schema import load_settings
    from allegro_twin.surfaces.cli.console import hint

    settings = load_settings(LabSettings, find_file(config, "config", "conf"))
    if pattern is not None:
        _print_pattern(pattern)
        return
    mount_file = None if out is None else out / MOUNT
    with options.interruptible(mount_file, otherwise="no mount is found"), ExitStack() as stack:
        folder = None if out is None else stack.enter_context(options.run_folder(out))
        if pictures is not None:
            mount, found = _from_folder(pictures, settings)
        else:
            mount, found = _simulated(settings, postures, seed, folder)
        if folder is not None:
            _write(folder / MOUNT, mount, found)
    _print(mount)
    if out is None:
        hint(f"Next: --out FOLDER writes {MOUNT}, whose block replaces `mount` of `camera` in the config")


def _from_folder(pictures: Path, settings: LabSettings) -> tuple[CameraMount, HandEyeCalibration]:
    import numpy as np

    from allegro_twin.cell.arm.arm_with_hand import BASE
    from allegro_twin.cell.calibration.pictures import calibrate_folder
    from allegro_twin.cell.calibration.simulated import camera_mount
    from allegro_twin.hands.description.arms import load_arm_spec
    from allegro_twin.kinematics.pose import Pose
    from allegro_twin.surfaces.cli.console import warn

    done = calibrate_folder(pictures, at_the_wrist=settings.at_the_wrist)
    for name in done.unseen:
        warn(f"{pictures / name}: shows too little of the pattern; left out")
    warn(done.warning)
    _print_error(done.found)
    flange = load_arm_spec(settings.arm.model).flange if settings.at_the_wrist else None
    return camera_mount(done.camera, flange, Pose(np.array(BASE), np.eye(3))), done.found


def _simulated(
    settings: LabSettings, postures: int, seed: int, folder: Path | None
) -> tuple[CameraMount, HandEyeCalibration]:
    import numpy as np

    from allegro_twin.cell.calibration.pattern import PatternSettings
    from allegro_twin.cell.calibration.pictures import calibrate_pictures, write_folder
    from allegro_twin.cell.calibration.simulated import CalibrationCell
    from allegro_twin.surfaces.cli.console import console, progress, warn

    cell = CalibrationCell(settings, PatternSettings(), seed)
    try:
        with progress() as bar:
            task = bar.add_task("pictures", total=postures)
            taken = list(cell.take(cell.postures(postures), lambda k: bar.update(task, completed=k)))
        if folder is not None:
            write_folder(folder, taken, cell.pattern, cell.lens)
        found, unseen = calibrate_pictures(taken, cell.pattern, cell.lens, np.zeros(0), at_the_wrist=cell.at_the_wrist)
        if unseen:
            warn(f"{', '.join(unseen)}: the hand hides the pattern; left out")
        _print_error(found)
        console.print(_deviation(cell, found), highlight=False, soft_wrap=True)
        return cell.mount(found.camera), found
    finally:
        cell.close()


def _print_error(found: HandEyeCalibration) -> None:
    import numpy as np

    from allegro_twin.surfaces.cli.console import console

    console.print(
        f"{len(found.views)} pictures, corners {found.residual:.2f} pixels off, {found.held_out:.2f} where left out; "
        f"turned by {np.degrees(found.turn):.0f}° about a second axis; the arm's poses are off by about "
        f"{1e3 * found.arm_position:.2f} mm and {np.degrees(found.arm_rotation):.3f}°",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    console.print(_accuracy(found), highlight=False, soft_wrap=True)


def _accuracy(found: HandEyeCalibration) -> str:
    import numpy as np

    return (
        f"the camera is known within {1e3 * found.position_error:.2f} mm and "
        f"{np.degrees(found.rotation_error):.3f}° (95 %)"
    )


def _deviation(cell: CalibrationCell, found: HandEyeCalibration) -> str:
    import numpy as np

    from allegro_twin.kinematics.orientation import angle_between

    far = np.linalg.norm(found.camera.position - cell.truth.position)
    turned = np.degrees(angle_between(found.camera.rotation, cell.truth.rotation))
    return f"in truth it is {1e3 * far:.2f} mm and {turned:.3f}° from there"


def _block(mount: CameraMount) -> dict[str, object]:
    return {key: list(v) if isinstance(v, tuple) else v for key, v in mount.model_dump(exclude_defaults=True).items()}


def _print(mount: CameraMount) -> None:
    from allegro_twin.surfaces.cli.console import console

    parts = ", ".join(f"{key}: {value}" for key, value in _block(mount).items())
    console.print(f"mount: {{{parts}}}", highlight=False, soft_wrap=True, markup=False)


def _write(path: Path, mount: CameraMount, found: HandEyeCalibration) -> None:
    from allegro_twin.files.yaml_edit import write_settings

    write_settings(path, {"mount": _block(mount)}, f"For `camera:` of the cell's config; {_accuracy(found)}")


def _print_pattern(path: Path) -> None:
    from allegro_twin.cell.calibration.pattern import PatternSettings, draw_pattern
    from allegro_twin.cell.calibration.pictures import write_picture
    from allegro_twin.surfaces.cli.console import console

    made = PatternSettings()
    write_picture(path, draw_pattern(made, _FINE))
    console.print(
        f"{path}: print it so that its {made.columns} squares are {1e3 * made.size[0]:.0f} mm wide, glue it on "
        "something flat, and write what a square really measures into calibration.yaml",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
