"""A LiDAR recording as a source of point clouds."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np

from laci_lidar.errors import ScanError
from laci_lidar.noise import USUAL_SIGMA_M, Noise, estimate_angle_sigma, estimate_range_sigma
from laci_lidar.point_times import Clock, is_own_clock
from laci_lidar.scan import Scan
from laci_lidar.sequence import ScanSequence
from laci_lidar.settings import LidarSettings, Sweep
from laci_lidar.view import View, learn_view
from laci_stereo.core.cloud import PointCloud, empty_cloud
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray
from laci_stereo.core.observe import GROUND_POINTS
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.subsampling import evenly, spread
from laci_stereo.core.tracking.background import BACKGROUND_FRAMES
from laci_stereo.io.ahead import workers
from laci_stereo.io.background import check_frames
from laci_stereo.io.text_file import listed

log = logging.getLogger(__name__)

NOISE_SCANS = 5
"""Number of scans from which the noise is estimated: each has thousands of points on the ground."""

GAP_PERIODS = 1.5
"""Scans farther apart than this many periods are not accumulated into one frame."""

MAX_READERS = 4

_UNTIMED = (
    "the scans do not tell when each point was taken{among}, so whether the scanner turns meanwhile, and which way, is "
    "found from the drive: --sweep tells it"
)
_ASSUMED = (
    "too few neighbouring points are on the ground for an estimate of the noise of ranges, which is taken as "
    f"{100 * USUAL_SIGMA_M:.0f} cm; --range-sigma tells another one"
)


@dataclass(frozen=True)
class Scanner:
    """Properties of a scanner, learnt from some scans before its recording is streamed.

    Attributes
    ----------
    view : View
    noise : Noise
    timed : bool
        The scans contain the time of each point.
    own_clock : bool
        These times are of the scanner's own clock, so that a scan's first point is assumed to be taken at its stamp.
    unused : tuple of str
        Fields of the points that contain no position, intensity or time.
    points : float
        Mean number of points of a scan.
    """

    view: View
    noise: Noise
    timed: bool
    own_clock: bool
    unused: tuple[str, ...]
    points: float


class LidarRecording:
    """Frames of a LiDAR (implements `PointCloudSource`).

    Parameters
    ----------
    scans : ScanSequence
    settings : LidarSettings
    ground : GroundSettings
        Settings of the first fit of the road plane, from which the noise follows.
    background : ScanSequence, range or None
        Scans without moving objects, as a sequence of their own or as indices of ``scans``. None: scans from all of the
        recording are used.
    name : str
        The user's name of the sensor.
    """

    kind = "lidar"

    def __init__(
        self,
        scans: ScanSequence,
        settings: LidarSettings | None = None,
        ground: GroundSettings | None = None,
        background: ScanSequence | range | None = None,
        name: str = "LiDAR",
    ) -> None:
        self.name = name
        self.scans = scans
        self.settings = settings or LidarSettings()
        self._ground = ground or GroundSettings()
        self._threads = self.settings.workers or min(workers(0), MAX_READERS)
        self._frames = group_scans(scans.stamps_ns, self.settings.accumulate)
        self._quiet, self._quiet_frames = self._frames_without_movers(background)

    @property
    def axes(self) -> Axes:
        """Directions of forward and up in the sensor frame."""
        return self.settings.axes

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp of the scans."""
        return int(self.scans.stamps_ns[0]), int(self.scans.stamps_ns[-1])

    @property
    def skipped(self) -> tuple[str, ...]:
        """The reason for each scan that could not be used, one line each."""
        return tuple(self.scans.skipped.values())

    def remarks(self) -> tuple[str, ...]:
        """Return what was assumed of the scanner, if anything."""
        unused = self.scanner.unused
        among = f" (not by their fields {listed(list(unused))})" if unused else ""
        return tuple(filter(None, (self.scanner.noise.assumed, _UNTIMED.format(among=among) if self._turn_s else "")))

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[PointCloud]:
        """Yield every frame."""
        return self._clouds(self.scans, self._frames)

    def survey(self) -> Iterator[PointCloud]:
        """Yield some whole frames, as many as the ground needs, and at least those that the background needs.

        Twenty scans of eight lasers have 20,000 points, and their noise tilts the road by as much as its waves do.
        """
        for_ground = math.ceil(GROUND_POINTS / (self.scanner.points * self.settings.accumulate))
        return self.whole_frames(max(BACKGROUND_FRAMES, for_ground))

    def whole_frames(self, most: int) -> Iterator[PointCloud]:
        """Yield at most so many frames, uniformly spaced, of those without moving objects if these are known."""
        return (cloud for cloud in self._clouds(self._quiet, spread(self._quiet_frames, most)) if len(cloud))

    @cached_property
    def scanner(self) -> Scanner:
        """The scanner's field of view and noise, as set or as learnt from the survey's scans.

        Raises
        ------
        ScanError
            If these scans cannot be read.
        GroundError
            If the noise of ranges is not set, and no ground is found.
        """
        indices = np.unique([frame[len(frame) // 2] for frame in spread(self._quiet_frames, BACKGROUND_FRAMES)])
        sampled = indices[evenly(len(indices), NOISE_SCANS)]
        kept: list[FloatArray] = []
        counts: list[int] = []
        spans_s: list[float] = []
        starts: list[tuple[float, Clock]] = []
        unused: dict[str, None] = {}

        def clouds() -> Iterator[FloatArray]:
            for index, scan in zip(indices, self._quiet.read(indices.tolist(), self._threads), strict=True):
                if scan is not None:
                    if scan.offset_s is not None:
                        spans_s.append(float(np.ptp(scan.offset_s)))
                        starts.append((float(scan.offset_s.min()), scan.clock))
                    unused.update(dict.fromkeys(scan.unused))
                    points = scan.points[self._far_enough(scan.points)]
                    counts.append(len(points))
                    if index in sampled:
                        kept.append(points)
                    yield points

        view = learn_view(clouds(), self.axes)
        if not any(len(points) for points in kept):
            nearest = f"{self.settings.min_range_m:g} m"
            raise ScanError(f"{self.scans.path}: all points are nearer than {nearest}; needed is a free view")
        steps_ns = np.diff(self._quiet.stamps_ns)
        period_s = float(np.median(steps_ns)) / 1e9 if len(steps_ns) else np.inf
        if spans_s and np.median(spans_s) > GAP_PERIODS * period_s:
            self._check_once(float(np.median(spans_s)), period_s, int(indices[len(indices) // 2]))
        noise, own_clock = self._noise(kept), is_own_clock(starts, period_s)
        scanner = Scanner(view, noise, bool(starts), own_clock, tuple(unused), float(np.mean(counts)))
        log.info(
            "scanner: %.0f deg wide, range within %.1f cm, bearing within %.2f deg",
            np.degrees(view.width_rad),
            100 * scanner.noise.range_sigma_m,
            np.degrees(scanner.noise.angle_sigma_rad),
        )
        return scanner

    def _check_once(self, span_s: float, period_s: float, index: int) -> None:
        """Raise if scans of duration ``span_s`` contain points of the preceding one, judged by two in the middle.

        Scans with a duration above the period may also be those of several scanners that rotate freely.
        """
        first = min(index, len(self._quiet) - 2)
        scans = islice(self._quiet.read([first, first + 1], 1), 2)  # read to its end, it raises if one is unusable
        earlier, later = (
            {tuple(point) for point in scan.points.tolist()} if scan is not None else set() for scan in scans
        )
        if 2 * len(earlier & later) > min(len(earlier), len(later)) > 0:
            raise ScanError(
                f"{self._quiet.path}: scans {first} and {first + 1} have {len(earlier & later)} points in common: a "
                f"scan's points were taken within {span_s:.2f} s, and scans are {period_s:.2f} s apart; needed is each "
                "point in one scan"
            )

    def _frames_without_movers(self, background: ScanSequence | range | None) -> tuple[ScanSequence, list[IntArray]]:
        if background is None:
            return self.scans, self._frames
        if not isinstance(background, range):
            return background, group_scans(background.stamps_ns, self.settings.accumulate)
        check_frames(background.start, background.stop - 1, len(self.scans), "scans")
        chosen = np.array(background)
        groups = group_scans(self.scans.stamps_ns[chosen], self.settings.accumulate)
        return self.scans, [chosen[group] for group in groups]

    def _noise(self, scans: Sequence[FloatArray]) -> Noise:
        angle, along = self.settings.angle_sigma_rad, self.settings.range_sigma_m
        if angle is None:
            angle = estimate_angle_sigma(scans)
        if along is None:
            along = estimate_range_sigma(scans, angle, self.axes, self._ground)
        if along is None:
            return Noise(USUAL_SIGMA_M, angle, _ASSUMED)
        return Noise(along, angle)

    def _clouds(self, sequence: ScanSequence, frames: Sequence[IntArray]) -> Iterator[PointCloud]:
        scanner = self.scanner
        scans = sequence.read([int(index) for frame in frames for index in frame], self._threads)
        for frame in frames:
            stamps = sequence.stamps_ns[frame]
            stamp_ns = int(stamps[len(stamps) // 2])
            parts = [(int(stamp) - stamp_ns, next(scans)) for stamp in stamps]
            yield self._cloud(stamp_ns, [(shift, scan) for shift, scan in parts if scan is not None], scanner)
        next(scans, None)  # at its end the sequence raises if too many could not be read

    def _cloud(self, stamp_ns: int, parts: Sequence[tuple[int, Scan]], scanner: Scanner) -> PointCloud:
        """Accumulate scans, each with its time after the frame's stamp in nanoseconds, into one frame."""
        if not parts:
            return empty_cloud(stamp_ns)
        points = np.concatenate([scan.points for _, scan in parts]) if len(parts) > 1 else parts[0][1].points
        offset_s = self._gathered_offsets_s(parts, scanner)
        keep = self._far_enough(points)
        if not keep.all():
            points, offset_s = points[keep], None if offset_s is None else offset_s[keep]
        return PointCloud(
            stamp_ns,
            points,
            sigma_along_m=np.full(len(points), scanner.noise.range_sigma_m),
            sigma_across_m=np.sqrt(np.einsum("ij,ij->i", points, points)) * scanner.noise.angle_sigma_rad,
            at_edge=scanner.view.at_edge(points),
            offset_s=offset_s,
            turn_s=self._turn_s,
            turned_rad=scanner.view.turned_rad(points) if self._turn_s else None,
        )

    @cached_property
    def _turn_s(self) -> float:
        """Duration of a rotation, seconds, if the scanner rotates in an unknown way, else 0."""
        if self.scanner.timed or self.settings.sweep is not None or len(self.scans) < 2:
            return 0.0
        return float(np.median(np.diff(self.scans.stamps_ns))) / 1e9

    def _gathered_offsets_s(self, parts: Sequence[tuple[int, Scan]], scanner: Scanner) -> FloatArray | None:
        """Return each point's time after the frame's stamp, seconds; None if all were taken at the stamp."""
        offsets = [self._offsets_s(scan, scanner) for _, scan in parts]
        if len(parts) == 1 and offsets[0] is None and parts[0][0] == 0:
            return None
        return np.concatenate(
            [
                np.full(len(scan), shift / 1e9) + (0.0 if own is None else own)
                for (shift, scan), own in zip(parts, offsets, strict=True)
            ]
        )

    def _offsets_s(self, scan: Scan, scanner: Scanner) -> FloatArray | None:
        sweep = self.settings.sweep
        if isinstance(sweep, Sweep):
            return scanner.view.offsets_s(scan.points, sweep)
        if sweep == "none" or scan.offset_s is None:
            return None
        return scan.offset_s - scan.offset_s.min() if scanner.own_clock and scan.clock == "stamp" else scan.offset_s

    def _far_enough(self, points: FloatArray) -> BoolArray:
        keep: BoolArray = np.einsum("ij,ij->i", points, points) >= self.settings.min_range_m**2
        return keep


def group_scans(stamps_ns: IntArray, size: int) -> list[IntArray]:
    """Group consecutive scans, at most ``size`` in a group and never across a gap; return their indices."""
    indices = np.arange(len(stamps_ns))
    if size == 1 or len(indices) < 2:
        return list(indices[:, None])
    steps = np.diff(stamps_ns)
    runs = np.split(indices, np.flatnonzero(steps > GAP_PERIODS * np.median(steps)) + 1)
    return [run[start : start + size] for run in runs for start in range(0, len(run), size)]
