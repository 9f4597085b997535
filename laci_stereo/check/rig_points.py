"""Matches on the common image plane of a stereo calibration, and the selection of those that show one scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from laci_stereo.check.rig_matches import MOVED_PX, PairMatches
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig
from laci_stereo.stereo.rectify import bouguet, undistorted

COLUMNS, ROWS = 8, 6
"""Numbers of cells in which systematic errors are separated from noise: lens and rotation errors are nearly constant
within a cell."""

TOLERANCE_PX = 3.0
"""A match farther from its epipolar line is an outlier, whatever the calibration: see `MOST_REFINED_PX`."""

TRIES = 2000
"""RANSAC hypotheses of the epipolar geometry. They suffice if half of the matches are correct: one sample of seven
matches in 2^7 = 128 is free of outliers."""


@dataclass(frozen=True)
class Rectified:
    """Matches of all pairs on the calibration's common image plane.

    Attributes
    ----------
    left, right : ndarray, shape (n, 2)
        Positions in the rectified images, pixels.
    flow_px, later_s : ndarray, shape (n, 2) and (n,)
        Motion of the left point until the next left image, minus the pair's median, and the time between; NaN if the
        point was not tracked.
    pair : ndarray of int, shape (n,)
    focal_px, baseline_m : float
    centre_px : ndarray, shape (2,)
    size : tuple of int
    sign : int
        Sign of disparities: -1 if the second camera is left of the first.
    """

    left: FloatArray
    right: FloatArray
    flow_px: FloatArray
    later_s: FloatArray
    pair: IntArray
    focal_px: float
    baseline_m: float
    centre_px: FloatArray
    size: tuple[int, int]
    sign: int

    def __len__(self) -> int:
        return len(self.left)

    @property
    def parallax_px(self) -> FloatArray:
        """Rows by which the right point is below the left point, shape (n,)."""
        found: FloatArray = self.right[:, 1] - self.left[:, 1]
        return found

    @property
    def disparity_px(self) -> FloatArray:
        """Disparity, shape (n,); positive in front of the cameras."""
        found: FloatArray = self.sign * (self.left[:, 0] - self.right[:, 0])
        return found

    @property
    def moves(self) -> BoolArray:
        """Which points move, shape (n,); points that were not tracked do not count as moving."""
        moved: BoolArray = np.linalg.norm(self.flow_px, axis=1) > MOVED_PX
        return moved

    @property
    def cell(self) -> IntArray:
        """Index of the cell of the left image that contains each point, shape (n,)."""
        column, row = (
            np.clip(self.left[:, axis] * count // self.size[axis], 0, count - 1).astype(np.int64)
            for axis, count in ((0, COLUMNS), (1, ROWS))
        )
        return row * COLUMNS + column

    def chosen(self, those: BoolArray) -> Rectified:
        """Return a subset of the matches."""
        return replace(
            self,
            left=self.left[those],
            right=self.right[those],
            flow_px=self.flow_px[those],
            later_s=self.later_s[those],
            pair=self.pair[those],
        )


def rectified(rig: StereoRig, matches: Sequence[PairMatches]) -> Rectified:
    """Project matches onto the common image plane of a calibration."""
    left_R, right_R, left_P, right_P = bouguet(rig)
    left = [_on_plane(rig.left, left_R, left_P, found.left) for found in matches]
    right = [_on_plane(rig.right, right_R, right_P, found.right) for found in matches]
    flow = [_on_plane(rig.left, left_R, left_P, found.later) - here for found, here in zip(matches, left, strict=True)]
    still = [np.nanmedian(moved, axis=0) if np.isfinite(moved).any() else np.zeros(2) for moved in flow]
    flow = [moved - shake for moved, shake in zip(flow, still, strict=True)]
    nothing = np.zeros((0, 2))
    whole = Rectified(
        np.concatenate([*left, nothing]),
        np.concatenate([*right, nothing]),
        np.concatenate([*flow, nothing]),
        np.concatenate([nothing[:, 0], *(np.full(len(found), found.later_s) for found in matches)]),
        np.concatenate([np.zeros(0, np.int64), *(np.full(len(found), i) for i, found in enumerate(matches))]),
        focal_px=float(left_P[0, 0]),
        baseline_m=float(abs(right_P[0, 3] / right_P[0, 0])),
        centre_px=left_P[:2, 2],
        size=rig.left.size,
        sign=-1 if right_P[0, 3] > 0 else 1,
    )
    return whole.chosen(np.isfinite(np.concatenate([whole.left, whole.right], axis=1)).all(axis=1))


def _on_plane(lens: Lens, R: FloatArray, P: FloatArray, points: FloatArray) -> FloatArray:
    """Convert raw pixels, shape (n, 2), to rectified ones; NaN stays NaN."""
    found = np.full(points.shape, np.nan)
    known = np.isfinite(points).all(axis=1)
    if known.any():
        found[known] = undistorted(lens, points[known], R, P)
    return found


def in_common(points: Rectified) -> tuple[Rectified, int]:
    """Return the matches of the pairs whose images show one scene, and the number of the other pairs.

    A pair's images show one scene if more matches agree on any one epipolar geometry than chance explains. Of N random
    matches, N p lie near a given line, p = 2 tolerance / height, and the best of many trials finds N p + sqrt(2 N p ln
    tries) + ln tries of them, in addition to the eight that determine the geometry.
    """
    keep = np.zeros(len(points), dtype=bool)
    strange = 0
    for number in np.unique(points.pair):
        in_pair = np.flatnonzero(points.pair == number)
        agreeing = _on_one_geometry(points.left[in_pair], points.right[in_pair])
        expected = len(in_pair) * 2 * TOLERANCE_PX / points.size[1]
        chance = 8 + expected + np.sqrt(2 * expected * np.log(TRIES)) + np.log(TRIES)
        if agreeing.sum() > chance:
            keep[in_pair[agreeing]] = True
        else:
            strange += 1
    return points.chosen(keep), strange


def _on_one_geometry(left: FloatArray, right: FloatArray) -> BoolArray:
    if len(left) < 9:
        return np.zeros(len(left), dtype=bool)
    _, mask = cv2.findFundamentalMat(left, right, cv2.FM_RANSAC, TOLERANCE_PX, 0.999, TRIES)
    if mask is None:
        return np.zeros(len(left), dtype=bool)
    agreeing: BoolArray = mask[:, 0] > 0
    return agreeing
