"""``laci-lidar``: parses arguments, returns exit codes."""

from __future__ import annotations

import math
from pathlib import Path

import click

from laci_lidar.check import check_scans
from laci_lidar.errors import ScanError
from laci_lidar.monitor_command import monitor as monitor_command
from laci_lidar.run import LidarOptions, prepare
from laci_lidar.scans import open_scans
from laci_lidar.settings import AtOnce, LidarSettings, Sweep
from laci_stereo.commands.check import check_free, deliver, map_options, needs_kind, placed_by, say_notes, the_map
from laci_stereo.commands.options import PATH, Asked, axes_option, calibrating, parse_background
from laci_stereo.commands.program import run_command
from laci_stereo.core.errors import SettingError
from laci_stereo.io.axes import parse_axes
from laci_stereo.io.maps.lane_map import find_lane_map
from laci_stereo.io.result.stored_calibration import read_calibration
from laci_stereo.job import Job


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="laci-stereo", message="%(prog)s %(version)s")
def cli() -> None:
    """Find where a roadside LiDAR stands and looks, from one connected vehicle that drives by.

    Exit codes: 0 calibrated, with the verdict pass or warn; 1 the input was read but does not determine a calibration,
    or its verdict is fail (the result is written, to be looked at); 2 the input cannot be read or makes no sense;
    130 interrupted.
    """


@cli.command()
@click.argument("scans", type=PATH)
@click.argument("cam", type=PATH)
@click.option("--topic", help="Topic with the point clouds, where a bag has several.")
@axes_option
@click.option("--range-sigma", type=float, metavar="M", help="Noise of a range [default: from the ground].")
@click.option("--angle-sigma", type=float, metavar="DEG", help="Noise of a bearing [default: from the beams' spacing].")
@click.option(
    "--sweep",
    metavar="AT,DIRECTION,HZ[,FROM]|none",
    help="How the scanner turns, where the points have no times of their own: start, middle or end for what the "
    "stamp is, ccw or cw seen from above, turns in a second; such as start,cw,10. FROM: where a scan begins, degrees "
    "counter-clockwise from forward [default: as the points' order has it, else behind]. none: all points of a scan "
    "belong to its stamp, as a flash LiDAR's, or those of scans that were motion-compensated.",
)
@click.option(
    "--accumulate",
    type=int,
    default=1,
    show_default=True,
    metavar="N",
    help="Scans gathered into one frame, for patterns that need several to fill the view; what moves is compensated.",
)
@click.option(
    "--background",
    metavar="START..END|PATH",
    help="Scans without moving objects: numbers from 0, or a folder or bag [default: found].",
)
@calibrating
def calibrate(
    asked: Asked,
    scans: Path,
    cam: Path,
    topic: str | None,
    axes: str,
    range_sigma: float | None,
    angle_sigma: float | None,
    sweep: str | None,
    accumulate: int,
    background: str | None,
) -> Job:
    """Calibrate a LiDAR.

    SCANS is a folder of PCD, PLY, LAS, LAZ, KITTI .bin, .npy or .npz files whose names, or a timestamps.txt among
    them, tell the time; or a ROS 1 bag, a ROS 2 bag or an MCAP file. CAM is a log of Cooperative Awareness
    Messages: CSV with the columns timestamp, station_id, latitude, longitude, heading, speed, vehicle_length and
    vehicle_width, or any other that `laci-stereo cam` reads: a packet capture, a ROS or MCAP bag, hexadecimal lines,
    V2AIX's JSON, or positions of a receiver in NMEA or GPX, which need --cam-reference.
    """
    options = LidarOptions(
        **vars(asked.drive(parse_background(background))),
        topic=topic,
        scanner=LidarSettings(
            range_sigma_m=range_sigma,
            angle_sigma_rad=None if angle_sigma is None else math.radians(angle_sigma),
            sweep=parse_sweep(sweep),
            accumulate=accumulate,
            axes=parse_axes(axes),
            workers=asked.workers,
        ),
    )
    return prepare(scans, cam, options)


@cli.command()
@click.argument("calibration", type=PATH)
@click.argument("scans", type=PATH)
@map_options
@click.option("--topic", help="Topic with the point clouds, where a bag has several.")
def check(
    calibration: Path,
    scans: Path,
    lane_map: Path | None,
    map_crs: str | None,
    map_sigma: float,
    json_file: Path | None,
    picture: Path,
    overwrite: bool,
    topic: str | None,
) -> None:
    """Check a LiDAR's calibration against a lane map.

    CALIBRATION is a result folder or its calibration.json, SCANS a recording, of any day. Paint is looked for in the
    points' intensity, where they have one; kerbs as steps in the ground; walls, fences and rails where points are
    above each other.

    Exit codes: 0 pass or cannot tell; 1 fail; 2 the input cannot be read or makes no sense.
    """
    check_free(picture, json_file, overwrite=overwrite)
    stored = read_calibration(calibration)
    needs_kind(stored, "lidar")
    lines = the_map(stored, lane_map or find_lane_map(scans), map_crs)
    say_notes(stored, lines)
    checked = check_scans(open_scans(scans, topic), placed_by(stored), lines, map_sigma)
    if checked is None:
        raise ScanError(
            f"{scans}: the points have no intensity, and the map has no kerbs or walls; needed is an intensity, for "
            "paint is seen by it, or a map with these"
        )
    deliver(checked, map_sigma, picture, json_file)


cli.add_command(monitor_command)


def parse_sweep(text: str | None) -> Sweep | AtOnce | None:
    """Parse ``AT,DIRECTION,HZ``, ``AT,DIRECTION,HZ,FROM`` or ``none``.

    Raises
    ------
    SettingError
        If the text has none of these forms.
    """
    if text is None or text == "none":
        return text  # type: ignore[return-value]
    needed = "needed is start|middle|end,ccw|cw,HZ, such as start,cw,10 or start,cw,10,-90, or none"
    parts = text.split(",")
    if len(parts) not in (3, 4) or parts[0] not in ("start", "middle", "end") or parts[1] not in ("ccw", "cw"):
        raise SettingError(f"--sweep is {text!r}; {needed}")
    try:
        numbers = [float(part) for part in parts[2:]]
    except ValueError as error:
        raise SettingError(f"--sweep is {text!r}; {needed}") from error
    return Sweep(parts[0], parts[1], *numbers)  # type: ignore[arg-type]


def main() -> None:
    """Run ``laci-lidar``."""
    run_command(cli, "laci-lidar")
