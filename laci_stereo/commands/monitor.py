"""``laci-stereo monitor``: where the objects of a long recording drive on the map."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from fnmatch import fnmatch
from functools import wraps
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click

from laci_stereo.commands.check import needs_kind, placed_by, stereo_option, the_map
from laci_stereo.commands.mask import asked_mask, mask_options
from laci_stereo.commands.options import (
    PATH,
    a_number,
    baseline_option,
    log_to_stderr,
    map_crs_option,
    say_written,
    verbosity_options,
    with_options,
    workers_option,
)
from laci_stereo.core.errors import ImageError, LaciError, OutputError, SettingError
from laci_stereo.core.settings import Settings
from laci_stereo.io.images import write_picture
from laci_stereo.io.maps.lane_map import LaneMap, find_lane_map
from laci_stereo.io.maps.lanelets import read_lanelets
from laci_stereo.io.output import whole_file, write_file
from laci_stereo.io.result.stored_calibration import StoredCalibration, read_calibration
from laci_stereo.io.rig.stereo_calibration import calibration_files
from laci_stereo.job import sha256
from laci_stereo.mask.contract import contract_beside
from laci_stereo.mask.network import Provider
from laci_stereo.mask.stage import VehicleMask
from laci_stereo.monitor.frames import Frames
from laci_stereo.monitor.lanes import strips_of
from laci_stereo.monitor.objects import Labelled, write_openlabel
from laci_stereo.monitor.picture import draw_histogram
from laci_stereo.monitor.report import document_of, findings, summary_of
from laci_stereo.monitor.run import STATE_FILE, TABLE_FILE, Monitor, Plan
from laci_stereo.monitor.settings import MonitorSettings
from laci_stereo.monitor.stereo import StereoFrames
from laci_stereo.start import INTERRUPTED
from laci_stereo.stereo.settings import StereoSettings

PICTURE_FILE, FIGURES_FILE, LABELS_FILE = "histogram.png", "monitor.json", "objects.json"
FILES = (STATE_FILE, TABLE_FILE, PICTURE_FILE, FIGURES_FILE, LABELS_FILE)

POLL_S = 1.0
POLL_SHARE = 0.1
"""Largest fraction of the time that is spent on listing a growing folder: with many files that takes longer than the
pause."""


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Options of every monitor, whatever the sensor."""

    calibration: Path
    lane_map: Path | None
    map_crs: str | None
    out: Path
    overwrite: bool
    follow: bool
    idle: float | None
    workers: int
    quiet: bool
    verbose: bool


@dataclass(frozen=True)
class Watched:
    """A recording to monitor.

    Attributes
    ----------
    frames : Frames
    beside : Path
        Folder beside which a map may be.
    files : mapping of str to Path
        Other files that the frames are read with, by name.
    """

    frames: Frames
    beside: Path
    files: dict[str, Path]


_common_options = with_options(
    click.argument("calibration", type=PATH),
    click.option("--map", "lane_map", type=PATH, help="Lane map [default: map.osm or the like beside the recording]."),
    map_crs_option,
    click.option("--out", type=PATH, default=Path("monitor"), show_default=True, help="Folder for what is found."),
    click.option("--overwrite", is_flag=True, help="Start afresh where a monitor has been before."),
    click.option("--follow", is_flag=True, help="Go on with files that come, until interrupted."),
    click.option(
        "--idle",
        type=click.FloatRange(min=0.0),
        callback=a_number,
        metavar="S",
        help="With --follow, end after S seconds without a file.",
    ),
    workers_option,
    verbosity_options,
)


def monitoring(kind: str) -> Callable[[Callable[..., Watched]], Callable[..., None]]:
    """Make a command of a function that opens a recording: add the options, monitor it, and report the findings."""

    def decorate(command: Callable[..., Watched]) -> Callable[..., None]:
        @wraps(command)
        def run(**given: Any) -> None:
            asked = Watch(**{field.name: given.pop(field.name) for field in fields(Watch)})
            log_to_stderr(quiet=asked.quiet, verbose=asked.verbose)
            if asked.idle is not None and not asked.follow:
                raise SettingError(f"--idle is {asked.idle:g} s; needed is --follow with it")
            stored = read_calibration(asked.calibration)
            needs_kind(stored, kind)
            watch(command(asked, stored, **given), stored, asked)

        return _common_options(run)

    return decorate


@click.command()
@monitoring("stereo")
@click.argument("left", type=PATH)
@click.argument("right", type=PATH)
@stereo_option
@click.option("--rectified", is_flag=True, help="The images are rectified already [default: as the calibration's].")
@baseline_option
@click.option("--vehicle-mask", type=PATH, metavar="MODEL.onnx", help="As in calibrate; see docs/vehicle_mask.md.")
@mask_options
def monitor(
    asked: Watch,
    stored: StoredCalibration,
    left: Path,
    right: Path,
    stereo: tuple[Path, ...],
    rectified: bool,
    baseline: float | None,
    vehicle_mask: Path | None,
    contract: Path | None,
    provider: Provider,
) -> Watched:
    """Count where the objects of a long stereo recording drive on the map.

    CALIBRATION is a result folder or its calibration.json, LEFT and RIGHT are folders of images as in calibrate. What
    was interrupted goes on where it was when the same command is given again.

    Exit codes: 0 done; 2 the input cannot be read or makes no sense; 130 interrupted.
    """
    options = asked_mask(vehicle_mask, contract, provider, asked.workers)
    mask, files = None, {}
    if options is not None:
        mask = VehicleMask.load(options)
        read_by = options.contract or contract_beside(options.model)
        files = {"vehicle mask": options.model} | ({} if read_by is None else {"mask contract": read_by})
    settings = StereoSettings(
        rectified=rectified or stored.rectified,
        baseline_m=baseline or stored.baseline_m,
        turn_deg=None if stereo else stored.turn_deg,
        workers=asked.workers,
    )
    rig_files = calibration_files(stereo, left)
    return Watched(StereoFrames(left, right, rig_files, settings, mask, follow=asked.follow), left, files)


def watch(watched: Watched, stored: StoredCalibration, asked: Watch) -> None:
    """Monitor a recording, from where an earlier run ended, and write the findings.

    Raises
    ------
    LaciError
    """
    map_file = asked.lane_map or find_lane_map(watched.beside)
    lane_map = the_map(stored, map_file, asked.map_crs)
    assert map_file is not None
    files = {"calibration": stored.path, "map": map_file, **watched.files}
    plan = plan_of(stored, lane_map, map_file, files, asked.map_crs)
    if not asked.follow:  # otherwise there may be no frames yet
        watched.frames.refresh(0)
    there = asked.out.exists()
    _make_folder(asked.out, overwrite=asked.overwrite)
    monitor: Monitor | None = None
    try:
        monitor = Monitor(watched.frames, plan, asked.out)
        monitor.refresh()
        monitor.check()
        if monitor.state.frames and not asked.quiet:
            click.echo(f"note: goes on after frame {monitor.state.frames}", err=True)
        _go_through(monitor, asked)
    except LaciError:
        if monitor is not None:
            _clear_up(asked.out, folder_too=not there)
        raise
    except KeyboardInterrupt:
        if monitor is None or not asked.follow:
            done = 0 if monitor is None else monitor.back().frames
            if not done:
                _clear_up(asked.out, folder_too=not there)
                raise
            click.echo(f"interrupted; {done} frames are done, and the same command goes on from there", err=True)
            sys.exit(INTERRUPTED)
        if not monitor.back().frames:  # the frames there are informative, even if fewer than a whole block
            monitor.step(ended=True)
    _deliver(monitor, watched, stored, lane_map, asked)


def plan_of(
    stored: StoredCalibration, lane_map: LaneMap, map_file: Path, files: dict[str, Path], map_crs: str | None
) -> Plan:
    """Return the map, the settings and the pose by which frames are evaluated.

    Raises
    ------
    MapError
    """
    settings, core = MonitorSettings(), Settings()
    identity = {name: sha256(path) for name, path in files.items()}
    stages = {name: asdict(getattr(core, name)) for name in ("background", "cluster", "box", "vehicle", "track")}
    for stage, values in {"monitor": asdict(settings), **stages}.items():
        identity |= {f"{stage}.{name}": str(value) for name, value in values.items()}
    strips = strips_of(lane_map, read_lanelets(map_file, lane_map), settings.boundary_reach_m)
    identity |= {"version": version("laci-stereo"), "map crs": str(map_crs)}
    return Plan(stored.world, stored.T_world_sensor, strips, identity, core, settings)


def _go_through(monitor: Monitor, asked: Watch) -> None:
    waits_since = time.monotonic()
    while asked.follow:
        start = time.monotonic()
        if _looked(monitor, asked):
            waits_since = time.monotonic()
        listing_s = time.monotonic() - start
        while monitor.step(ended=False):
            _show(monitor, asked)
            waits_since = time.monotonic()
        if asked.idle is not None and time.monotonic() - waits_since >= asked.idle:
            break
        time.sleep(max(POLL_S, listing_s / POLL_SHARE))
    while monitor.step(ended=True):
        _show(monitor, asked)


def _looked(monitor: Monitor, asked: Watch) -> bool:
    """Look for new frames, and return whether there are any; announce the first ones, as counts come much later."""
    known = len(monitor.frames.stamps_ns)
    monitor.refresh()
    now = len(monitor.frames.stamps_ns)
    if now and not known and not asked.quiet:
        block_s = monitor.plan.settings.block_s
        click.echo(f"note: {now} frames so far; counts begin when {block_s:g} s of them are there", err=True)
    return now > known


def _show(monitor: Monitor, asked: Watch) -> None:
    """Print the progress on a terminal."""
    if sys.stderr.isatty() and not asked.quiet:
        state = monitor.state
        known = len(monitor.frames.stamps_ns)
        end = "" if state.frames < known else "\n"
        click.echo(f"\r{state.frames} of {known} frames, {state.tally.passages} passages{end}", nl=False, err=True)


def _make_folder(out: Path, *, overwrite: bool) -> None:
    """Make the folder, or clear it of an earlier monitor if that was requested.

    Raises
    ------
    OutputError
        If it contains other files, or cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        inside = sorted(out.iterdir())
        left_behind = [path for path in inside if any(fnmatch(path.name, f".{name}.*") for name in FILES)]
        foreign = [path for path in inside if path.name not in FILES and path not in left_behind]
        if foreign:
            raise OutputError(f"{out}: holds {foreign[0].name}, which is no part of a monitor; needed is another --out")
        for path in inside if overwrite else left_behind:
            path.unlink()
    except OSError as problem:
        raise OutputError(f"{out}: cannot be written ({problem.strerror}); needed is a folder to write to") from problem


def _clear_up(out: Path, *, folder_too: bool) -> None:
    """Remove the files of a monitor that ended before its first checkpoint."""
    if (out / STATE_FILE).exists():
        return
    (out / TABLE_FILE).unlink(missing_ok=True)
    if folder_too:
        out.rmdir()


def _deliver(monitor: Monitor, watched: Watched, stored: StoredCalibration, lane_map: LaneMap, asked: Watch) -> None:
    """Write the outputs and print the summary."""
    state, plan = monitor.finish(), monitor.plan
    if not state.frames:
        raise ImageError(f"{watched.frames.uri}: 0 frames are whole; needed is at least one to say anything")
    found = findings(plan, placed_by(stored), state)
    write_picture(asked.out / PICTURE_FILE, draw_histogram(plan, state, found, lane_map))
    _write_labels(asked.out, monitor, Labelled(stored.name, stored.kind, watched.frames.uri, plan.world))
    document = document_of(plan, state, found, watched.frames.uri)
    write_file(asked.out / FIGURES_FILE, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
    if not asked.quiet:
        click.echo(summary_of(plan, state, found))
        say_written(asked.out)


def _write_labels(out: Path, monitor: Monitor, labelled: Labelled) -> None:
    with whole_file(out / LABELS_FILE) as temporary, temporary.open("w", encoding="utf-8") as stream:
        write_openlabel(stream, out / TABLE_FILE, monitor.longest_frames, labelled)
