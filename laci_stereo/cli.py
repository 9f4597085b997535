"""``laci-stereo``: arguments in, exit codes out; the only place that prints."""

from __future__ import annotations

import logging
import math
import os
import re
import shlex
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from types import FrameType
from typing import Any

import click

from laci_stereo.cam_command import cam as cam_command
from laci_stereo.check_command import check as check_command
from laci_stereo.combine import CombineOptions
from laci_stereo.combine import combine as combine_runs
from laci_stereo.compare_command import compare_command
from laci_stereo.core.cam import CENTRE, FRONT, ReferencePoint
from laci_stereo.core.cloud import PointCloud, PointCloudSource
from laci_stereo.core.errors import CalibrationError, LaciError, SettingError
from laci_stereo.core.frames import Axes
from laci_stereo.core.settings import GroundSettings, JointSettings, MatchSettings, Method, Settings
from laci_stereo.io.axes import parse_axes
from laci_stereo.io.output import check_output
from laci_stereo.job import DriveOptions, Job, Result, Task
from laci_stereo.mask.network import MaskOptions, Provider
from laci_stereo.mask_command import mask as mask_command
from laci_stereo.mask_command import mask_options
from laci_stereo.match import BoxOrigin, MatchOptions, MatchTask
from laci_stereo.match import prepare as prepare_match
from laci_stereo.run import Options, prepare
from laci_stereo.stereo.settings import StereoSettings

NOT_CALIBRATED = 1
UNUSABLE_INPUT = 2
INTERRUPTED = 130

UNKNOWN_CLOCK_S = 1.0
"""Standard deviation of the offset between clocks of which nothing is known but that people set them."""


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="laci-stereo", message="%(prog)s %(version)s")
def cli() -> None:
    """Find where a roadside stereo camera stands and looks, from one connected vehicle that drives by.

    Exit codes: 0 calibrated; 1 the input was read but does not determine a calibration; 2 the input cannot be read
    or makes no sense; 130 interrupted.
    """


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What every calibrating command is asked, whatever the sensor; ``workers`` only where there are frames."""

    out: Path
    overwrite: bool
    lane_map: Path | None
    station: int | None
    cam_reference: str
    crs: str | None
    height: float | None
    method: Method
    clock: str
    clock_sigma: float | None
    name: str | None
    workers: int = 0
    quiet: bool
    verbose: bool

    def drive(self, background: tuple[int, int] | Path | None) -> DriveOptions:
        """Return what of it concerns the drive.

        Raises
        ------
        SettingError
            If it makes no sense.
        """
        return DriveOptions(
            lane_map=self.lane_map,
            station=self.station,
            reference=parse_reference(self.cam_reference),
            crs=self.crs,
            name=self.name,
            background=background,
            core=core_settings(self.method, self.height, clock_sigma(self.clock, self.clock_sigma)),
        )


_PATH = click.Path(path_type=Path)

_ASKED = (
    click.option("--out", type=_PATH, default=Path("calibration"), show_default=True, help="Folder for the result."),
    click.option("--overwrite", is_flag=True, help="Replace a result that is there already."),
    click.option(
        "--map", "lane_map", type=_PATH, help="Lanelet2 or GeoJSON lane map [default: map.osm beside the recording]."
    ),
    click.option("--station", type=int, help="Sender, where the log has several [default: the one whose track fits]."),
    click.option(
        "--cam-reference",
        default="front",
        show_default=True,
        metavar="front|center|rear-axle:X|X,Y",
        help="Where on the vehicle its position is: centre of the front side (ETSI), of the box, rear axle X m behind "
        "the box's centre, or X m ahead and Y m left of it.",
    ),
    click.option("--crs", help="UTM zone, as EPSG:32632 [default: the zone of the positions]."),
    click.option("--height", type=float, metavar="M", help="About how high the sensor hangs [default: found]."),
    click.option(
        "--method",
        type=click.Choice(["joint", "paper"]),
        default="joint",
        show_default=True,
        help="Estimator: the outline in all frames at once, or the paper's; the result shows both.",
    ),
    click.option(
        "--clock",
        type=click.Choice(["known", "unknown"]),
        default="known",
        show_default=True,
        help="Whether sensor and sender follow one clock, to some 10 ms, or may be a second apart.",
    ),
    click.option(
        "--clock-sigma", type=float, metavar="S", help="How far apart their clocks are, one standard deviation, s."
    ),
    click.option("--name", help="What you call the sensor [default: the folder around the recording]."),
)


_WORKERS = click.option(
    "--workers", type=click.IntRange(min=0), default=0, help="Threads [default: one per processor, up to 8]."
)

_SAID = (
    click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors."),
    click.option("-v", "--verbose", is_flag=True, help="Say what each stage finds."),
)


def calibrating(command: Callable[..., Task]) -> Callable[..., None]:
    """Make a command of a function that prepares the task of a sensor whose frames are read."""
    return _asking(command, (*_ASKED, _WORKERS, *_SAID))


def matching(command: Callable[..., Task]) -> Callable[..., None]:
    """Make a command of a function that prepares a task without frames."""
    return _asking(command, (*_ASKED, *_SAID))


def _asking(command: Callable[..., Task], options: Sequence[Callable[[Any], Any]]) -> Callable[..., None]:
    """Make a command of a function that prepares a task: add the common options, run the task, save and print."""

    @wraps(command)
    def run(**given: Any) -> None:
        asked = Asked(**{field.name: given.pop(field.name) for field in fields(Asked) if field.name in given})
        _log_to_stderr(quiet=asked.quiet, verbose=asked.verbose)
        check_output(asked.out, overwrite=asked.overwrite)
        _carry_out(command(asked, **given), asked)

    for option in reversed(options):
        run = option(run)
    return run


def _carry_out(job: Task, asked: Asked) -> None:
    if not asked.quiet:
        for note in job.provenance.notes:
            click.echo(f"note: {note}", err=True)
    result = job.run(lambda source: source if asked.quiet else WithProgress(source))
    _deliver(result, job.skipped, asked.out, overwrite=asked.overwrite, quiet=asked.quiet)


def _deliver(result: Result, notes: Sequence[str], out: Path, *, overwrite: bool, quiet: bool) -> None:
    """Save a result and say what it is."""
    result.save(out, overwrite=overwrite, command=_command())
    if not quiet:
        for note in notes:
            click.echo(f"note: {note}", err=True)
        click.echo(result.summary)
        click.echo(f"{'Written':<11}{out}: {', '.join(sorted(path.name for path in out.iterdir()))}")


def _command() -> str:
    """Return the command line as it could be typed again."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


@cli.command()
@click.argument("left", type=_PATH)
@click.argument("right", type=_PATH)
@click.argument("cam", type=_PATH)
@click.option("--stereo", type=_PATH, help="Stereo calibration [default: stereo.yaml, .yml or .json beside LEFT].")
@click.option("--rectified", is_flag=True, help="The images are rectified already.")
@click.option(
    "--background",
    metavar="START..END|DIR",
    help="Frames without moving objects: numbers from 0, or a folder with left/ and right/ [default: found].",
)
@click.option("--disparities", metavar="MIN..MAX", help="Disparities to search, pixels [default: from the geometry].")
@click.option(
    "--vehicle-mask",
    type=_PATH,
    metavar="MODEL.onnx",
    help="A detector or segmenter of your own that tells vehicles from what else moves; see docs/vehicle_mask.md.",
)
@mask_options
@calibrating
def calibrate(
    asked: Asked,
    left: Path,
    right: Path,
    cam: Path,
    stereo: Path | None,
    rectified: bool,
    background: str | None,
    disparities: str | None,
    vehicle_mask: Path | None,
    contract: Path | None,
    provider: Provider,
) -> Job:
    """Calibrate a stereo camera.

    LEFT and RIGHT are folders of images whose names, or a timestamps.txt among them, tell the time. CAM is a CSV log
    of Cooperative Awareness Messages with the columns timestamp, station_id, latitude, longitude, heading, speed,
    vehicle_length and vehicle_width.
    """
    options = Options(
        **vars(asked.drive(parse_background(background))),
        stereo=stereo,
        camera=StereoSettings(rectified=rectified, disparities=parse_disparities(disparities), workers=asked.workers),
        mask=asked_mask(vehicle_mask, contract, provider, asked.workers),
    )
    return prepare(left, right, cam, options)


@cli.command()
@click.argument("detections", type=_PATH)
@click.argument("cam", type=_PATH)
@click.option(
    "--axes",
    default="x forward, z up",
    show_default=True,
    help="Which way the sensor's axes point, such as 'y forward' or 'z down'.",
)
@click.option(
    "--box-origin",
    type=click.Choice(["centre", "bottom"]),
    default="centre",
    show_default=True,
    help="What of a box its position is.",
)
@click.option(
    "--level",
    type=float,
    metavar="HEIGHT",
    help="The sensor's up axis is vertical, HEIGHT m above the ground [default: found below the boxes].",
)
@matching
def match(
    asked: Asked, detections: Path, cam: Path, axes: str, box_origin: BoxOrigin, level: float | None
) -> MatchTask:
    """Calibrate a sensor from the boxes of your own detector, radar or camera or LiDAR.

    DETECTIONS is a CSV file with the columns timestamp, x, y, z, yaw, length, width and height, optionally track_id
    and radial_speed, in the sensor's frame, in metres and radians; with --level, timestamp, x and y suffice. CAM is a
    CSV log of Cooperative Awareness Messages with the columns timestamp, station_id, latitude, longitude, heading,
    speed, vehicle_length and vehicle_width.
    """
    options = MatchOptions(**vars(asked.drive(None)), axes=parse_axes(axes), box_origin=box_origin, level_m=level)
    return prepare_match(detections, cam, options)


@cli.command()
@click.argument("runs", nargs=-1, required=True, type=_PATH, metavar="RUN...")
@click.option("--out", type=_PATH, default=Path("calibration"), show_default=True, help="Folder for the result.")
@click.option("--overwrite", is_flag=True, help="Replace a result that is there already.")
@click.option("--map", "lane_map", type=_PATH, help="Lanelet2 or GeoJSON lane map; only drawn.")
@click.option("--name", help="What you call the sensor [default: as in the first RUN].")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
@click.option("-v", "--verbose", is_flag=True, help="Say what each stage finds.")
def combine(
    runs: tuple[Path, ...],
    out: Path,
    overwrite: bool,
    lane_map: Path | None,
    name: str | None,
    quiet: bool,
    verbose: bool,
) -> None:
    """Estimate over the drives of several results at once.

    RUN are result folders of one sensor, of any of the calibrating commands; the vehicles may differ. A drive that
    contradicts the others is named and left out.
    """
    _log_to_stderr(quiet=quiet, verbose=verbose)
    check_output(out, overwrite=overwrite)
    result = combine_runs(runs, CombineOptions(name=name, lane_map=lane_map))
    _deliver(result, (*result.job.provenance.notes, *result.job.skipped), out, overwrite=overwrite, quiet=quiet)


cli.add_command(cam_command)
cli.add_command(check_command)
cli.add_command(compare_command)
cli.add_command(mask_command)


class WithProgress:
    """A source that shows on a terminal how far its frames are consumed, and how long it will take."""

    def __init__(self, source: PointCloudSource) -> None:
        self._source = source

    @property
    def kind(self) -> str:
        """As the source's."""
        return self._source.kind

    @property
    def name(self) -> str:
        """As the source's."""
        return self._source.name

    @property
    def axes(self) -> Axes:
        """As the source's."""
        return self._source.axes

    @property
    def span_ns(self) -> tuple[int, int]:
        """As the source's."""
        return self._source.span_ns

    def __len__(self) -> int:
        return len(self._source)

    def __iter__(self) -> Iterator[PointCloud]:
        yield from self._shown(iter(self._source), len(self._source), "frames")

    def survey(self) -> Iterator[PointCloud]:
        """As the source's."""
        yield from self._shown(self._source.survey(), None, "survey")

    @staticmethod
    def _shown(clouds: Iterator[PointCloud], length: int | None, label: str) -> Iterator[PointCloud]:
        if not sys.stderr.isatty():
            yield from clouds
            return
        with click.progressbar(clouds, length=length, label=label, show_pos=True, file=sys.stderr) as bar:
            yield from bar


def parse_background(text: str | None) -> tuple[int, int] | Path | None:
    """Read ``START..END`` or the path of another recording.

    Raises
    ------
    SettingError
        If it is neither.
    """
    if text is None:
        return None
    numbers = _interval(text)
    if numbers is not None:
        return numbers
    if Path(text).exists():
        return Path(text)
    raise SettingError(f"--background is {text!r}; needed is START..END in frame numbers, or an existing folder")


def parse_disparities(text: str | None) -> tuple[int, int] | None:
    """Read ``MIN..MAX``.

    Raises
    ------
    SettingError
        If it is not that.
    """
    if text is None:
        return None
    numbers = _interval(text)
    if numbers is None:
        raise SettingError(f"--disparities is {text!r}; needed is MIN..MAX in pixels, such as 0..64")
    return numbers


def _interval(text: str) -> tuple[int, int] | None:
    found = re.fullmatch(r"(\d{1,9})\.\.(\d{1,9})", text)
    return (int(found[1]), int(found[2])) if found else None


def parse_reference(text: str) -> ReferencePoint:
    """Read ``front``, ``center``, ``rear-axle:X`` or ``X,Y``.

    Raises
    ------
    SettingError
        If it is none of them.
    """
    if text == "front":
        return FRONT
    if text in {"center", "centre"}:
        return CENTRE
    number = r"([+-]?\d+(?:\.\d+)?)"
    axle = re.fullmatch(rf"rear-axle:{number}", text)
    if axle:
        return ReferencePoint(-float(axle[1]))
    point = re.fullmatch(rf"{number},{number}", text)
    if point:
        return ReferencePoint(float(point[1]), float(point[2]))
    raise SettingError(f"--cam-reference is {text!r}; needed is front, center, rear-axle:X or X,Y in metres")


def asked_mask(model: Path | None, contract: Path | None, provider: Provider, workers: int) -> MaskOptions | None:
    """Put together what was said about a vehicle mask.

    Raises
    ------
    SettingError
        If something was said of one, but not which.
    """
    if model is not None:
        return MaskOptions(model, contract, provider, workers)
    if contract is not None:
        raise SettingError(f"--mask-contract is {contract} without a mask; needed is --vehicle-mask MODEL.onnx")
    return None


def ground_near(height_m: float | None) -> GroundSettings:
    """Bound the height over the ground by what the user says about it, give or take a third.

    Raises
    ------
    SettingError
        If it is not a positive number.
    """
    if height_m is None:
        return GroundSettings()
    if not 0 < height_m < math.inf:
        raise SettingError(f"--height is {height_m} m; needed is a number above 0")
    return GroundSettings(min_height_m=height_m * 2 / 3, max_height_m=height_m * 4 / 3)


def clock_sigma(clock: str, sigma_s: float | None) -> float:
    """Return the standard deviation of the clocks' offset in seconds: as said, else by what is known of them.

    Raises
    ------
    SettingError
        If it is not a number above 0, or said twice.
    """
    if sigma_s is None:
        return UNKNOWN_CLOCK_S if clock == "unknown" else JointSettings().clock_sigma_s
    if clock == "unknown":
        raise SettingError(f"--clock is unknown and --clock-sigma is {sigma_s} s; needed is one of them")
    if not 0 < sigma_s < math.inf:
        raise SettingError(f"--clock-sigma is {sigma_s} s; needed is a number above 0")
    return sigma_s


def core_settings(method: Method, height_m: float | None, clock_sigma_s: float) -> Settings:
    """Put what was asked over the core's defaults."""
    return Settings(
        method=method,
        ground=ground_near(height_m),
        match=MatchSettings(clock_sigma_s=clock_sigma_s),
        joint=JointSettings(clock_sigma_s=clock_sigma_s),
    )


def _log_to_stderr(*, quiet: bool, verbose: bool) -> None:
    logging.basicConfig(
        level=logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING,
        format="%(levelname)s: %(message)s",
        force=True,
    )


def _terminate(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def main() -> None:
    """Run ``laci-stereo``."""
    run_command(cli, "laci-stereo")


def run_command(command: click.Command, program: str) -> None:
    """Run a command line: every error that is the input's becomes one line and an exit code."""
    _silence_decoders()
    signal.signal(signal.SIGTERM, _terminate)  # so that a half-written result is removed
    message, code = _outcome(command, program)
    if message:
        click.echo(f"{program}: {message}", err=True)
    sys.exit(code)


def _outcome(command: click.Command, program: str) -> tuple[str, int]:
    """Return what to say, in one line, and the exit code."""
    try:
        command(prog_name=program, standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        return "interrupted; nothing was written", INTERRUPTED
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return "", error.exit_code
    except click.UsageError as error:
        asked = error.ctx.command_path if error.ctx is not None else program
        return f"{error.format_message().rstrip('.')}; see {asked} --help", UNUSABLE_INPUT
    except CalibrationError as error:
        return f"not calibrated: {error}", NOT_CALIBRATED
    except LaciError as error:
        return str(error), UNUSABLE_INPUT
    except OSError as error:  # a file system that fails under a path that was readable before
        return f"{error.filename or 'input or output'}: {error.strerror}", UNUSABLE_INPUT
    return "", 0


def _silence_decoders() -> None:
    """Keep standard error for ourselves: libjpeg writes to its descriptor, whatever one sets, about damaged images."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    if sys.stderr is None:  # closed by whoever started the command
        sys.stderr = os.fdopen(nowhere, "w", encoding="utf-8")
        return
    ours = os.dup(sys.stderr.fileno())
    os.dup2(nowhere, sys.stderr.fileno())
    os.close(nowhere)
    sys.stderr = os.fdopen(ours, "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors)
