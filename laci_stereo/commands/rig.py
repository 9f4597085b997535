"""``laci-stereo rig``: how a stereo calibration was understood, and whether it fits the images."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from laci_stereo.check.rig_describe import describe_rig, rig_document
from laci_stereo.check.rig_images import check_rig, match_images
from laci_stereo.check.rig_picture import draw_rig
from laci_stereo.commands.options import PATH, baseline_option, say_written
from laci_stereo.commands.program import NEGATIVE
from laci_stereo.core.errors import ImageError, SettingError
from laci_stereo.io.images import IMAGES, ImageFolder, StereoPair, first_size, pair_images, write_picture
from laci_stereo.io.output import check_files, check_png, write_document
from laci_stereo.io.rig.stereo_calibration import calibration_files, read_rig
from laci_stereo.io.rig.stereo_rig import ForImages
from laci_stereo.io.timed_files import names_in
from laci_stereo.stereo.rectify import already_rectified


@click.command()
@click.argument("paths", nargs=-1, type=PATH, metavar="[CALIB]... LEFT RIGHT")
@click.option("--rectified", is_flag=True, help="The images are rectified already.")
@baseline_option
@click.option("--picture", type=PATH, help="File for a picture of the rectified pair with its matches (PNG).")
@click.option("--json", "json_file", type=PATH, help="File for all figures.")
@click.option("--overwrite", is_flag=True, help="Replace files that are there already.")
def rig(
    paths: tuple[Path, ...],
    rectified: bool,
    baseline: float | None,
    picture: Path | None,
    json_file: Path | None,
    overwrite: bool,
) -> None:
    """Show how a stereo calibration is understood, and whether it fits the images.

    CALIB is a file, two files that belong together, or a folder with them, as for --stereo; without it, it is looked
    for beside LEFT. LEFT and RIGHT are folders of images. Points are matched in some pairs without the calibration;
    after rectification by it, partners must lie in one row.

    Exit codes: 0 it fits, perhaps with a warning; 1 it does not; 2 something cannot be read or makes no sense.
    """
    calibration, left, right = _parted(paths)
    check_files([picture, json_file], overwrite=overwrite)
    check_png(picture)
    files = calibration_files(calibration, left)
    pairs = _pairs(left, right)
    found = read_rig(files, ForImages(first_size(pair.left for pair in pairs), left, baseline, right))
    check = check_rig(already_rectified(found) if rectified else found, match_images(pairs))
    click.echo(describe_rig(files, check))
    if picture is not None:
        write_picture(picture, draw_rig(check))
    if json_file is not None:
        write_document(json_file, rig_document(files, check))
    say_written(picture, json_file)
    if check.outcome == "fail":
        sys.exit(NEGATIVE)


def _parted(paths: tuple[Path, ...]) -> tuple[tuple[Path, ...], Path, Path]:
    """Return the files of the calibration and the two folders of images.

    Raises
    ------
    SettingError
        If one of the folders is missing.
    """
    folders = [path for path in paths[-2:] if not path.is_file()]
    if len(folders) < 2:
        found = ", ".join(map(str, paths)) or "nothing"
        raise SettingError(
            f"{found} given to rig; needed are LEFT and RIGHT, two folders of images, after the calibration's files"
        )
    return paths[:-2], paths[-2], paths[-1]


def _pairs(left: Path, right: Path) -> tuple[StereoPair, ...]:
    """Pair images by their times; by name where names are the same but contain no time, or there is one image only."""
    try:
        return pair_images(ImageFolder.open(left), ImageFolder.open(right)).pairs
    except ImageError:
        names = names_in(left, IMAGES)
        if names != names_in(right, IMAGES) or left.resolve() == right.resolve():
            raise
        return tuple(StereoPair(0, left / name, right / name) for name in names)
