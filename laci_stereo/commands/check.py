"""``laci-stereo check``: whether a map's lines coincide with the road's, for an existing calibration."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import numpy as np

from laci_stereo.check.describe import check_document, describe_check
from laci_stereo.check.images import Checked, check_images
from laci_stereo.check.lanes import MAP_SIGMA_M
from laci_stereo.check.placed import Placed
from laci_stereo.check.verdict import TOO_FAR_M, TOO_FAR_RAD
from laci_stereo.commands.options import PATH, a_number, baseline_option, map_crs_option, say_written, with_options
from laci_stereo.commands.program import NEGATIVE
from laci_stereo.core.errors import CalibrationFileError, MapError
from laci_stereo.io.images import ImageFolder, first_size, write_picture
from laci_stereo.io.maps.lane_map import MAP_FILES, LaneMap, find_lane_map, read_lane_map
from laci_stereo.io.output import check_files, check_png, write_document
from laci_stereo.io.result.stored_calibration import StoredCalibration, read_calibration
from laci_stereo.io.rig.stereo_calibration import calibration_files, read_stereo_calibration
from laci_stereo.stereo.reader import GreyReader
from laci_stereo.stereo.rectify import already_rectified

UNCLAIMED = np.diag([0.0, 0.0, TOO_FAR_RAD**2, TOO_FAR_M**2, TOO_FAR_M**2, 0.0])
"""Assumed covariance of a calibration without one: within the plane, errors that a pass rules out must be possible.
Errors of its tilt and height also displace the lines on the ground, and are counted as such."""


map_options = with_options(
    click.option("--map", "lane_map", type=PATH, help="Lane map [default: map.osm or the like beside the data]."),
    map_crs_option,
    click.option(
        "--map-sigma",
        type=click.FloatRange(min=0.0, max=10.0),
        callback=a_number,
        default=MAP_SIGMA_M,
        show_default=True,
        metavar="M",
        help="Error of a line's place in the map, one standard deviation.",
    ),
    click.option("--json", "json_file", type=PATH, help="File for all figures."),
    click.option(
        "--picture", type=PATH, default=Path("check.png"), show_default=True, help="File for the picture (PNG)."
    ),
    click.option("--overwrite", is_flag=True, help="Replace files that are there already."),
)
"""The options of a check, whatever the sensor."""


stereo_option = click.option(
    "--stereo",
    type=PATH,
    multiple=True,
    help="Stereo calibration: a file, a folder with one, or, given twice, two files that belong together (left and "
    "right, intrinsics and extrinsics) [default: found beside LEFT].",
)


@click.command()
@click.argument("calibration", type=PATH)
@click.argument("left", type=PATH)
@map_options
@stereo_option
@click.option("--rectified", is_flag=True, help="The images are rectified already [default: as the calibration's].")
@baseline_option
def check(
    calibration: Path,
    left: Path,
    lane_map: Path | None,
    map_crs: str | None,
    map_sigma: float,
    json_file: Path | None,
    picture: Path,
    overwrite: bool,
    stereo: tuple[Path, ...],
    rectified: bool,
    baseline: float | None,
) -> None:
    """Check a stereo camera's calibration against a lane map.

    CALIBRATION is a result folder or its calibration.json, LEFT a folder of left images, of any day. The lines'
    paint is looked for in the median of some images.

    Exit codes: 0 pass or cannot tell; 1 fail; 2 the input cannot be read or makes no sense.
    """
    check_free(picture, json_file, overwrite=overwrite)
    stored = read_calibration(calibration)
    needs_kind(stored, "stereo")
    folder = ImageFolder.open(left)
    files, size = calibration_files(stereo, left), first_size(folder.files)
    rig = read_stereo_calibration(files, size, left, baseline or stored.baseline_m)
    rig = already_rectified(rig) if rectified or stored.rectified else rig
    lines = the_map(stored, lane_map or find_lane_map(left), map_crs)
    say_notes(stored, lines)
    checked = check_images(folder.files, GreyReader(rig), rig.left, placed_by(stored), lines, map_sigma)
    deliver(checked, map_sigma, picture, json_file)


def check_free(picture: Path, json_file: Path | None, *, overwrite: bool) -> None:
    """Check, before any work is done, whether the files can be written.

    Raises
    ------
    OutputError
    """
    check_files([picture, json_file], overwrite=overwrite)
    check_png(picture)


def needs_kind(stored: StoredCalibration, kind: str) -> None:
    """Raise if a result is of another kind of sensor.

    Raises
    ------
    CalibrationFileError
    """
    if stored.kind != kind:
        raise CalibrationFileError(f"{stored.path}: the sensor's kind is {stored.kind}; needed is {kind}")


def the_map(stored: StoredCalibration, path: Path | None, crs: str | None) -> LaneMap:
    """Read the map, in the world frame of a result.

    Raises
    ------
    MapError
    """
    if path is None:
        raise MapError(f"none of {', '.join(MAP_FILES)} lies beside the data; needed is --map FILE")
    return read_lane_map(path, stored.world, crs)


def placed_by(stored: StoredCalibration) -> Placed:
    """Return the sensor's pose by a result; one without a covariance is assumed as uncertain as a pass rules out."""
    covariance = stored.covariance if stored.claims else UNCLAIMED
    return Placed(stored.T_world_sensor, covariance, stored.centre_world, stored.boxes)


def say_notes(stored: StoredCalibration, lines: LaneMap) -> None:
    """Print how the map was understood, and what was assumed about the result."""
    for note in lines.notes:
        click.echo(f"note: {note}", err=True)
    if not stored.claims:
        click.echo(
            f"note: {stored.path} was imported and does not say how good it is; taken are {TOO_FAR_M:g} m and "
            f"{np.degrees(TOO_FAR_RAD):g} deg in the plane, one sigma, which a pass rules out",
            err=True,
        )


def deliver(checked: Checked, map_sigma_m: float, picture: Path, json_file: Path | None) -> None:
    """Print the verdict, write the files, and exit with the verdict's code if it failed."""
    click.echo(describe_check(checked.check))
    write_picture(picture, checked.picture)
    if json_file is not None:
        write_document(json_file, check_document(checked.check, map_sigma_m))
    say_written(picture, json_file)
    if checked.check.judgement.outcome == "fail":
        sys.exit(NEGATIVE)
