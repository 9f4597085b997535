"""The options that all calibrating commands share, and the output of their results."""

from __future__ import annotations

import logging
import math
import re
import shlex
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Any

import click

from laci_stereo.core.cloud import PointCloud, PointCloudSource
from laci_stereo.core.errors import GroundError, SettingError, VerdictError
from laci_stereo.core.frames import Axes
from laci_stereo.core.messages.cam import CENTRE, FRONT, ReferencePoint
from laci_stereo.core.settings import (
    METHODS,
    SYNCHRONISED_S,
    UNKNOWN_CLOCK_S,
    GroundSettings,
    JointSettings,
    Method,
    QualitySettings,
    Settings,
    above_zero,
)
from laci_stereo.io.output import check_output
from laci_stereo.io.rig.stereo_rig import MAX_BASELINE_M, MIN_BASELINE_M
from laci_stereo.job import DriveOptions, Result, Task

SURE_CLOCK_S, LOST_CLOCK_S = 1e-6, 60.0
"""No clocks are synchronised more closely than the first, and beyond the second the messages cannot be assigned to
vehicles."""

EXACT_M, INEXACT_M = 0.001, 100.0
"""No position of a moving vehicle is more exact than the first, and one that is less exact than the second calibrates
nothing."""

LONGEST_M = 30.0
"""No vehicle on a road is longer (25.25 m, directive 96/53/EC), and its reference point is no farther from its
centre."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The options of every calibrating command, for any sensor; ``workers`` applies only to those that read frames."""

    out: Path
    overwrite: bool
    lane_map: Path | None
    map_crs: str | None
    station: int | None
    cam_reference: str | None
    cam_sigma: float | None
    crs: str | None
    height: float | None
    method: Method
    clock: str
    clock_sigma: float | None
    max_sigma_m: float
    max_sigma_deg: float
    name: str | None
    workers: int = 0
    quiet: bool
    verbose: bool

    def drive(self, background: tuple[int, int] | Path | None) -> DriveOptions:
        """Return the options that concern the drive.

        Raises
        ------
        SettingError
            If one makes no sense.
        """
        return DriveOptions(
            lane_map=self.lane_map,
            map_crs=self.map_crs,
            station=self.station,
            reference=None if self.cam_reference is None else parse_reference(self.cam_reference),
            cam_sigma_m=cam_sigma(self.cam_sigma),
            crs=self.crs,
            name=self.name,
            background=background,
            core=Settings(
                method=self.method,
                ground=ground_near(self.height),
                quality=limits(self.max_sigma_m, self.max_sigma_deg),
            ).with_clock(clock_sigma(self.clock, self.clock_sigma)),
        )


PATH = click.Path(path_type=Path)


def with_options(*options: Callable[[Any], Any]) -> Callable[[click.decorators.FC], click.decorators.FC]:
    """Return several options, in the order in which the help lists them, as one decorator."""

    def add(command: click.decorators.FC) -> click.decorators.FC:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def a_number(_context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    """Refuse NaN, which no range refuses: it is neither below nor above the limits."""
    if value is not None and math.isnan(value):
        raise click.BadParameter(f"{value} is not a number; needed is one", param=parameter)
    return value


map_crs_option = click.option(
    "--map-crs",
    metavar="CRS[@E,N]",
    help="Coordinate system of a map that does not state it, as EPSG:25832; E,N is the origin of its coordinates.",
)

axes_option = click.option(
    "--axes",
    default="x forward, z up",
    show_default=True,
    help="Which way the sensor's axes point, such as 'y forward' or 'z down'.",
)

baseline_option = click.option(
    "--baseline",
    type=click.FloatRange(MIN_BASELINE_M, MAX_BASELINE_M),
    callback=a_number,
    metavar="M",
    help="Metres between the cameras, where the stereo calibration's lengths are in an unknown unit, such as squares "
    "of a chessboard [default: as it says, else metres].",
)

max_sigma_m_option = click.option(
    "--max-sigma-m",
    type=float,
    metavar="M",
    default=QualitySettings.max_sigma_m,
    show_default=True,
    help="Largest uncertainty of positions along the track for a pass, one standard deviation, m; up to "
    f"{QualitySettings.fail_factor:g} times that is a warning.",
)

max_sigma_deg_option = click.option(
    "--max-sigma-deg",
    type=float,
    metavar="DEG",
    default=QualitySettings.max_sigma_deg,
    show_default=True,
    help="The same for the yaw, degrees; the limit of the tilt is twice that.",
)

_common_options = with_options(
    click.option("--out", type=PATH, default=Path("calibration"), show_default=True, help="Folder for the result."),
    click.option("--overwrite", is_flag=True, help="Replace a result that is there already."),
    click.option(
        "--map",
        "lane_map",
        type=PATH,
        help="Lane map: Lanelet2, OpenDRIVE, GeoJSON, DXF or CSV [default: map.osm or the like beside the recording].",
    ),
    map_crs_option,
    click.option("--station", type=int, help="Sender, if the log has several [default: all that are clearly seen]."),
    click.option(
        "--cam-reference",
        metavar="front|center|rear-axle:X|X,Y",
        help="Point of the vehicle that the positions are of: centre of the front side (ETSI), of the box, rear axle "
        "X m behind the box's centre, or X m ahead and Y m left of it [default: front; required if a log's positions "
        "are an antenna's].",
    ),
    click.option(
        "--cam-sigma",
        type=float,
        metavar="M",
        help="Accuracy of positions whose messages do not report it, one standard deviation along each axis, m "
        f"[default: {JointSettings.position_sigma_m:g}, that of a receiver with carrier-phase corrections (RTK)].",
    ),
    click.option("--crs", help="UTM zone, as EPSG:32632 [default: the zone of the positions]."),
    click.option(
        "--height",
        type=float,
        metavar="M",
        help="Height of the sensor above the road, m, good to a third [default: estimated].",
    ),
    click.option(
        "--method",
        type=click.Choice(METHODS),
        default="joint",
        show_default=True,
        help="Estimator: the outline in all frames at once, or the paper's; the result shows both.",
    ),
    click.option(
        "--clock",
        type=click.Choice(["known", "unknown"]),
        default="known",
        show_default=True,
        help="Whether the clocks of sensor and sender are synchronised, to some 10 ms, or may be a second apart.",
    ),
    click.option(
        "--clock-sigma",
        type=float,
        metavar="S",
        help="Offset between their clocks, one standard deviation, s [default: "
        f"{SYNCHRONISED_S:g}; {UNKNOWN_CLOCK_S:g} with --clock unknown].",
    ),
    max_sigma_m_option,
    max_sigma_deg_option,
    click.option(
        "--name",
        help="Name of the sensor [default: the folder around images or detections, the folder or bag of scans].",
    ),
)


workers_option = click.option(
    "--workers", type=click.IntRange(min=0), default=0, help="Threads [default: one per processor, up to 8]."
)

verbosity_options = with_options(
    click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors."),
    click.option("-v", "--verbose", is_flag=True, help="Say what each stage finds."),
)


def calibrating(command: Callable[..., Task]) -> Callable[..., None]:
    """Turn a function that prepares a task into a command, for a sensor whose frames are read."""
    return with_options(_common_options, workers_option, verbosity_options)(_running(command))


def matching(command: Callable[..., Task]) -> Callable[..., None]:
    """Turn a function that prepares a task without frames into a command."""
    return with_options(_common_options, verbosity_options)(_running(command))


def _running(command: Callable[..., Task]) -> Callable[..., None]:
    """Return a function that takes the common options as well, runs the task that is prepared, saves and prints."""

    @wraps(command)
    def run(**given: Any) -> None:
        asked = Asked(**{field.name: given.pop(field.name) for field in fields(Asked) if field.name in given})
        log_to_stderr(quiet=asked.quiet, verbose=asked.verbose)
        check_output(asked.out, overwrite=asked.overwrite)
        _carry_out(command(asked, **given), asked)

    return run


def _carry_out(job: Task, asked: Asked) -> None:
    said = job.provenance.notes
    if not asked.quiet:
        _say(said)
    try:
        result = job.run(lambda source: source if asked.quiet else WithProgress(source))
    except GroundError as error:
        if asked.height is None:
            raise
        raise GroundError(f"{error}; --height is {asked.height:g} m, which is taken give or take a third") from error
    deliver(result, asked.out, overwrite=asked.overwrite, quiet=asked.quiet, said=said)


def _say(notes: Iterable[str]) -> None:
    for note in notes:
        click.echo(f"note: {note}", err=True)


def deliver(result: Result, out: Path, *, overwrite: bool, quiet: bool, said: Collection[str] = ()) -> None:
    """Save a result and print its notes and its summary.

    Parameters
    ----------
    result : Result
        Its job may have been prepared anew during the run, and then has notes that the first one did not have.
    out : Path
        The result folder.
    overwrite, quiet : bool
    said : collection of str
        Notes that were printed before.

    Raises
    ------
    VerdictError
        If the result must not be used; it is saved for inspection.
    """
    result.save(out, overwrite=overwrite, command=_command())
    if not quiet:
        job = result.job
        _say(result.calibration.found)
        _say(note for note in (*job.provenance.notes, *job.remarks(), *job.skipped) if note not in said)
        click.echo(result.summary)
        say_written(out)
    quality = result.calibration.quality
    if quality.verdict == "fail":
        raise VerdictError(f"the verdict is fail: {'; '.join(quality.reasons)}; {out} shows what was found")


def say_written(*written: Path | str | None, err: bool = False) -> None:
    """Print which files were written, if any: of a folder, the files in it; strings are printed as they are."""
    there = [_with_content(each) for each in written if each is not None]
    if there:
        click.echo(f"{'Written':<11}{', '.join(there)}", err=err)


def _with_content(written: Path | str) -> str:
    if isinstance(written, str) or not written.is_dir():
        return str(written)
    return f"{written}: {', '.join(sorted(each.name for each in written.iterdir()))}"


def _command() -> str:
    """Return the command line as it could be typed again."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


class WithProgress:
    """A source that shows on a terminal how many of its frames are consumed, and the time that remains."""

    def __init__(self, source: PointCloudSource) -> None:
        self._source = source

    @property
    def axes(self) -> Axes:
        """The axes of the wrapped source."""
        return self._source.axes

    @property
    def span_ns(self) -> tuple[int, int]:
        """The first and last stamp of the wrapped source."""
        return self._source.span_ns

    def __len__(self) -> int:
        return len(self._source)

    def __iter__(self) -> Iterator[PointCloud]:
        yield from self._shown(iter(self._source), len(self._source), "frames")

    def survey(self) -> Iterator[PointCloud]:
        """Yield the survey of the wrapped source."""
        yield from self._shown(self._source.survey(), None, "survey")

    @staticmethod
    def _shown(clouds: Iterator[PointCloud], length: int | None, label: str) -> Iterator[PointCloud]:
        if not sys.stderr.isatty():
            yield from clouds
            return
        with click.progressbar(clouds, length=length, label=label, show_pos=True, file=sys.stderr) as bar:
            yield from bar


def parse_background(text: str | None) -> tuple[int, int] | Path | None:
    """Parse ``START..END`` or the path of another recording.

    Raises
    ------
    SettingError
        If the text is neither.
    """
    if text is None:
        return None
    numbers = interval(text)
    if numbers is not None:
        return numbers
    if Path(text).exists():
        return Path(text)
    raise SettingError(f"--background is {text!r}; needed is START..END in frame numbers, or an existing folder")


def interval(text: str) -> tuple[int, int] | None:
    """Parse ``A..B``; return None if the text has another form."""
    found = re.fullmatch(r"(\d{1,9})\.\.(\d{1,9})", text)
    return (int(found[1]), int(found[2])) if found else None


def parse_reference(text: str) -> ReferencePoint:
    """Parse ``front``, ``center``, ``rear-axle:X`` or ``X,Y``.

    Raises
    ------
    SettingError
        If the text is none of them, or a distance is above `LONGEST_M`.
    """
    if text == "front":
        return FRONT
    if text in {"center", "centre"}:
        return CENTRE
    number = r"([+-]?\d+(?:\.\d+)?)"
    axle = re.fullmatch(rf"rear-axle:{number}", text)
    if axle and abs(float(axle[1])) <= LONGEST_M:
        return ReferencePoint(-float(axle[1]))
    point = re.fullmatch(rf"{number},{number}", text)
    if point and max(abs(float(value)) for value in point.groups()) <= LONGEST_M:
        return ReferencePoint(float(point[1]), float(point[2]))
    raise SettingError(
        f"--cam-reference is {text!r}; needed is front, center, rear-axle:X or X,Y in metres, up to {LONGEST_M:g}"
    )


def ground_near(height_m: float | None) -> GroundSettings:
    """Return settings that bound the height above the ground to within a third of the height that the user states.

    Raises
    ------
    SettingError
        If it is not a positive number.
    """
    if height_m is None:
        return GroundSettings()
    above_zero("--height", height_m, "m")
    return GroundSettings(min_height_m=height_m * 2 / 3, max_height_m=height_m * 4 / 3)


def clock_sigma(clock: str, sigma_s: float | None) -> float:
    """Return the standard deviation of the clock offset in seconds: as given, else the default for ``clock``.

    Raises
    ------
    SettingError
        If it is out of range, or both options are given.
    """
    if sigma_s is None:
        return UNKNOWN_CLOCK_S if clock == "unknown" else SYNCHRONISED_S
    if clock == "unknown":
        raise SettingError(f"--clock is unknown and --clock-sigma is {sigma_s} s; needed is one of them")
    if not SURE_CLOCK_S <= sigma_s <= LOST_CLOCK_S:
        raise SettingError(f"--clock-sigma is {sigma_s} s; needed is {SURE_CLOCK_S:g} to {LOST_CLOCK_S:g}")
    return sigma_s


def cam_sigma(sigma_m: float | None) -> float | None:
    """Check the standard deviation of positions, metres, and return it.

    Raises
    ------
    SettingError
        If no position can be as exact as that, or it is too large to be of use.
    """
    if sigma_m is not None and not EXACT_M <= sigma_m <= INEXACT_M:
        raise SettingError(f"--cam-sigma is {sigma_m} m; needed is {EXACT_M:g} to {INEXACT_M:g}")
    return sigma_m


def limits(max_sigma_m: float, max_sigma_deg: float) -> QualitySettings:
    """Return the settings of the verdict.

    Raises
    ------
    SettingError
        If one is not a positive number.
    """
    return QualitySettings(
        max_sigma_m=above_zero("--max-sigma-m", max_sigma_m, "m"),
        max_sigma_deg=above_zero("--max-sigma-deg", max_sigma_deg, "deg"),
    )


def log_to_stderr(*, quiet: bool, verbose: bool) -> None:
    """Log to standard error at the requested level of detail."""
    logging.basicConfig(
        level=logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING,
        format="%(levelname)s: %(message)s",
        force=True,
    )
