"""The core's interface to a sensor: point clouds with their noise, one per frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray

MAX_BAD_SHARE = 0.2
"""Largest tolerated fraction of unreadable frames of a recording; a larger one is an error."""


@dataclass(frozen=True)
class Cameras:
    """The two cameras whose images were matched.

    Attributes
    ----------
    baseline_m : ndarray, shape (3,)
        Vector from the left to the right camera, metres.
    ahead : ndarray, shape (3,)
        Unit vector along the optical axis of the rectified images.
    """

    baseline_m: FloatArray
    ahead: FloatArray

    def turned(self, R: FloatArray) -> Cameras:
        """Return the same cameras in a frame into which ``R``, shape (3, 3), rotates vectors."""
        return Cameras(R @ self.baseline_m, R @ self.ahead)


@dataclass(frozen=True)
class PointCloud:
    """One frame of a sensor.

    Noise is given along and across the line of sight from the sensor's origin: a stereo camera is accurate in bearing
    and inaccurate in depth, a LiDAR is the reverse, and one ellipsoid of revolution per point describes both.

    Attributes
    ----------
    stamp_ns : int
        Unix time, nanoseconds.
    points : ndarray, shape (n, 3)
        Points in the sensor frame, metres, finite.
    sigma_along_m, sigma_across_m : ndarray, shape (n,)
        Standard deviations along and across the line of sight, metres.
    at_edge : ndarray of bool, shape (n,)
        Whether the point lies at the border of the field of view, so that its object may be cut off there.
    offset_s : ndarray, shape (n,), or None
        Time of each point relative to ``stamp_ns``, seconds: a turn of a scanner lasts a tenth of a second, in which a
        car at 10 m/s moves by a metre. None if all points were measured at the stamp.
    turn_s : float
        Duration of a turn of a scanner of which neither the points' times are known nor whether it turns; 0 for all
        other sensors.
    turned_rad : ndarray, shape (n,), or None
        Azimuth of each point, counter-clockwise from the one at which such a scanner's scans begin, 0 to 2 pi.
    window_rad : float
        Side of a camera's square matching window, as an angle: points in one window share their noise. 0 if the noise
        of each point is independent.
    cameras : Cameras or None
        In the sensor frame; None for all other sensors.
    others : PointCloud or None
        Further points that move but do not belong to a vehicle according to a mask.
    """

    stamp_ns: int
    points: FloatArray
    sigma_along_m: FloatArray
    sigma_across_m: FloatArray
    at_edge: BoolArray
    offset_s: FloatArray | None = None
    turn_s: float = 0.0
    turned_rad: FloatArray | None = None
    window_rad: float = 0.0
    cameras: Cameras | None = None
    others: PointCloud | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        assert self.points.shape == (n, 3), self.points.shape
        assert self.sigma_along_m.shape == self.sigma_across_m.shape == self.at_edge.shape == (n,)
        assert self.offset_s is None or self.offset_s.shape == (n,)
        assert self.turned_rad is None or self.turned_rad.shape == (n,)

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, keep: BoolArray | IntArray) -> PointCloud:
        return PointCloud(
            self.stamp_ns,
            self.points[keep],
            self.sigma_along_m[keep],
            self.sigma_across_m[keep],
            self.at_edge[keep],
            None if self.offset_s is None else self.offset_s[keep],
            self.turn_s,
            None if self.turned_rad is None else self.turned_rad[keep],
            self.window_rad,
            self.cameras,
        )


def window_of(clouds: Sequence[PointCloud]) -> float:
    """Return the side of the matching window of the camera that some clouds are of, radians; 0 for a scanner."""
    return max(cloud.window_rad for cloud in clouds)


class PointCloudSource(Protocol):
    """A recording: a sequence of frames that are made on demand, and can be iterated over repeatedly.

    Memory must not grow with the recording's length, so neither method may keep the frames that it has yielded.
    """

    @property
    def axes(self) -> Axes:
        """The forward and up axes in the sensor frame."""

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp, Unix time, nanoseconds."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def __iter__(self) -> Iterator[PointCloud]:
        """Yield every frame in the order of time; points that the source knows to be static may be missing."""

    def survey(self) -> Iterator[PointCloud]:
        """Yield some whole frames from all of the recording, preferably those in which little moves.

        Their points determine the ground: of frames with few points there should be more.
        """


def empty_cloud(stamp_ns: int) -> PointCloud:
    """Return a frame without points."""
    nothing = np.zeros(0)
    return PointCloud(stamp_ns, np.zeros((0, 3)), nothing, nothing, np.zeros(0, dtype=bool))
