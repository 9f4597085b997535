"""The command line ``laci-stereo``: arguments in, exit codes out."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import click

from laci_stereo.combine import CombineOptions, check_kept
from laci_stereo.combine import combine as combine_runs
from laci_stereo.commands.cam import cam as cam_command
from laci_stereo.commands.check import check as check_command
from laci_stereo.commands.check import stereo_option
from laci_stereo.commands.compare import compare_command
from laci_stereo.commands.exporting import export as export_command
from laci_stereo.commands.importing import import_command
from laci_stereo.commands.mask import asked_mask, mask_options
from laci_stereo.commands.mask import mask as mask_command
from laci_stereo.commands.monitor import monitor as monitor_command
from laci_stereo.commands.options import (
    PATH,
    Asked,
    axes_option,
    baseline_option,
    calibrating,
    deliver,
    interval,
    limits,
    log_to_stderr,
    map_crs_option,
    matching,
    max_sigma_deg_option,
    max_sigma_m_option,
    parse_background,
    verbosity_options,
)
from laci_stereo.commands.program import run_command
from laci_stereo.commands.rig import rig as rig_command
from laci_stereo.core.errors import SettingError
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.box_point import BoxPoint
from laci_stereo.io.axes import parse_axes
from laci_stereo.io.output import check_output
from laci_stereo.job import Job
from laci_stereo.mask.network import Provider
from laci_stereo.match import BoxOrigin, MatchOptions, MatchTask
from laci_stereo.match import prepare as prepare_match
from laci_stereo.run import Options, prepare
from laci_stereo.stereo.settings import StereoSettings


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="laci-stereo", message="%(prog)s %(version)s")
def cli() -> None:
    """Find where a roadside stereo camera stands and looks, from one connected vehicle that drives by.

    Exit codes: 0 calibrated, with the verdict pass or warn; 1 the input was read but does not determine a calibration,
    or its verdict is fail (the result is written, to be looked at); 2 the input cannot be read or makes no sense;
    130 interrupted.
    """


@cli.command()
@click.argument("left", type=PATH)
@click.argument("right", type=PATH)
@click.argument("cam", type=PATH)
@stereo_option
@click.option("--rectified", is_flag=True, help="The images are rectified already.")
@baseline_option
@click.option(
    "--background",
    metavar="START..END|DIR",
    help="Frames without moving objects: numbers from 0, or a folder with left/ and right/ [default: found].",
)
@click.option("--disparities", metavar="MIN..MAX", help="Disparities to search, pixels [default: from the geometry].")
@click.option(
    "--vehicle-mask",
    type=PATH,
    metavar="MODEL.onnx",
    help="A detector or segmenter of your own that tells vehicles from other moving objects; see docs/vehicle_mask.md.",
)
@mask_options
@calibrating
def calibrate(
    asked: Asked,
    left: Path,
    right: Path,
    cam: Path,
    stereo: tuple[Path, ...],
    rectified: bool,
    baseline: float | None,
    background: str | None,
    disparities: str | None,
    vehicle_mask: Path | None,
    contract: Path | None,
    provider: Provider,
) -> Job:
    """Calibrate a stereo camera.

    LEFT and RIGHT are folders of images, whose times are in their names or in a timestamps.txt. CAM is a log of
    Cooperative Awareness Messages: CSV with the columns timestamp, station_id, latitude, longitude, heading, speed,
    vehicle_length and vehicle_width, or any other that `laci-stereo cam` reads: a packet capture, a ROS or MCAP bag,
    hexadecimal lines, V2AIX's JSON, or positions of a receiver (NMEA, GPX), which need --cam-reference.
    """
    options = Options(
        **vars(asked.drive(parse_background(background))),
        stereo=stereo,
        camera=StereoSettings(
            rectified=rectified,
            baseline_m=baseline,
            disparities=parse_disparities(disparities),
            workers=asked.workers,
        ),
        mask=asked_mask(vehicle_mask, contract, provider, asked.workers),
    )
    return prepare(left, right, cam, options)


@cli.command()
@click.argument("detections", type=PATH)
@click.argument("cam", type=PATH)
@axes_option
@click.option(
    "--box-origin",
    type=click.Choice(get_args(BoxOrigin)),
    default="centre",
    show_default=True,
    help="Height in a box that its position is of.",
)
@click.option(
    "--box-point",
    type=click.Choice(get_args(BoxPoint)),
    default="centre",
    show_default=True,
    help="Point of a box, seen from above, that its position is of; front is where yaw points to.",
)
@click.option(
    "--level",
    type=float,
    metavar="HEIGHT",
    help="Take the sensor's up axis as vertical, HEIGHT m above the ground [default: fitted below the boxes].",
)
@matching
def match(
    asked: Asked,
    detections: Path,
    cam: Path,
    axes: str,
    box_origin: BoxOrigin,
    box_point: BoxPoint,
    level: float | None,
) -> MatchTask:
    """Calibrate a sensor from the boxes that your own detector finds with a radar, a camera or a LiDAR.

    DETECTIONS is a CSV file with the columns timestamp, x, y, z, yaw, length, width and height, optionally track_id
    and radial_speed (m/s, positive away from the sensor), in the sensor's frame, in metres and radians, yaw from x
    towards y; with --level, timestamp, x and y suffice. CAM is a log of Cooperative Awareness Messages: CSV with the
    columns timestamp, station_id, latitude, longitude, heading, speed, vehicle_length and vehicle_width, or any other
    that `laci-stereo cam` reads: a packet capture, a ROS or MCAP bag, hexadecimal lines, V2AIX's JSON, or positions of
    a receiver in NMEA or GPX, which need --cam-reference.
    """
    options = MatchOptions(
        **vars(asked.drive(None)),
        axes=parse_axes(axes),
        box_origin=box_origin,
        box_point=box_point,
        level_m=level,
    )
    return prepare_match(detections, cam, options)


@cli.command()
@click.argument("runs", nargs=-1, required=True, type=PATH, metavar="RUN...")
@click.option("--out", type=PATH, default=Path("calibration"), show_default=True, help="Folder for the result.")
@click.option("--overwrite", is_flag=True, help="Replace a result that is there already.")
@click.option("--map", "lane_map", type=PATH, help="Lane map; only drawn.")
@map_crs_option
@max_sigma_m_option
@max_sigma_deg_option
@click.option("--name", help="Name of the sensor [default: as in the first RUN].")
@verbosity_options
def combine(
    runs: tuple[Path, ...],
    out: Path,
    overwrite: bool,
    lane_map: Path | None,
    map_crs: str | None,
    max_sigma_m: float,
    max_sigma_deg: float,
    name: str | None,
    quiet: bool,
    verbose: bool,
) -> None:
    """Estimate over the drives of several results at once.

    RUN are result folders of one sensor, of any of the calibrating commands; the vehicles may differ. A drive that
    contradicts the others is named and left out.
    """
    log_to_stderr(quiet=quiet, verbose=verbose)
    check_output(out, overwrite=overwrite)
    check_kept(runs, out)
    core = Settings(quality=limits(max_sigma_m, max_sigma_deg))
    result = combine_runs(runs, CombineOptions(name=name, lane_map=lane_map, map_crs=map_crs, core=core))
    deliver(result, out, overwrite=overwrite, quiet=quiet)


cli.add_command(cam_command)
cli.add_command(check_command)
cli.add_command(compare_command)
cli.add_command(export_command)
cli.add_command(import_command)
cli.add_command(mask_command)
cli.add_command(rig_command)
cli.add_command(monitor_command)


def parse_disparities(text: str | None) -> tuple[int, int] | None:
    """Parse ``MIN..MAX``.

    Raises
    ------
    SettingError
        If the text has another form.
    """
    if text is None:
        return None
    numbers = interval(text)
    if numbers is None:
        raise SettingError(f"--disparities is {text!r}; needed is MIN..MAX in pixels, such as 0..64")
    return numbers


def main() -> None:
    """Run ``laci-stereo``."""
    run_command(cli, "laci-stereo")
