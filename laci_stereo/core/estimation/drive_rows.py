"""The distances of a drive's points from the outline, and the parameters by which they have derivatives.

"Face" is the part of the outline that a line of sight meets (`outline.FACES`).
"""

from __future__ import annotations

from dataclasses import dataclass

from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.vehicle import outline

BIAS, SWEEP, FOCAL, BASELINE, APART = range(3, 8)
FIRST_OWN = 8
"""Number of the sensor's parameters: yaw, x, y, range bias, rotation of a scanner, the relative amounts by which the
focal length and the baseline of a stereo camera are given too small, and the time from its left to its right images, s.
The range bias is in standard deviations of each point; for boxes, in those of what all share
(`JointSettings.boxes_range_m`) over that of the prior (`JointSettings.bias_noise_share`). They are followed by each
drive's own parameters, see `drive_prior`."""

BY_OPTICS = slice(FOCAL, BASELINE + 1)
"""Focal length and baseline among the parameters and the columns of the derivatives."""


@dataclass(frozen=True)
class SightLines(Columns):
    """Lines of sight: where their points are, and what they meet on the outline.

    Attributes
    ----------
    points : ndarray of int, shape (n,)
        Indices of the drive's points; indices after the last point stand for the borders of each frame.
    hits : Hits
    arm : ndarray, shape (n, 2)
        Position relative to ``centre``, in the axes of the level frame.
    xy : ndarray, shape (n, 2)
        Point in the vehicle frame.
    z : ndarray, shape (n,)
        Its height above the ground.
    origin : ndarray, shape (n, 2)
        Sensor in the vehicle frame.
    yaw : ndarray, shape (n,)
        Yaw of the body in the world frame.
    farther : ndarray, shape (n,)
        Fraction by which the point is measured too far per second between left and right images; 0 for scanners.
    """

    points: IntArray
    hits: outline.Hits
    arm: FloatArray
    xy: FloatArray
    z: FloatArray
    origin: FloatArray
    yaw: FloatArray
    farther: FloatArray


@dataclass(frozen=True)
class Chosen:
    """The points that are compared with the outline.

    Attributes
    ----------
    points : ndarray of int, shape (n,)
        Indices of the drive's points.
    share : ndarray, shape (n,)
        Weight of each point, below 1 as its noise is correlated with that of others.
    unsure : ndarray, shape (m,)
        For each frame, see `Poses`. Like the weights it must stay constant during a descent.
    """

    points: IntArray
    share: FloatArray
    unsure: FloatArray


@dataclass(frozen=True)
class Rows(Columns):
    """Distances from the outline, those of borders last, with their derivatives by all parameters before the knots.

    Attributes
    ----------
    distance, variance : ndarray, shape (n,)
        Signed distance from the outline, metres, and its variance.
    cos : ndarray, shape (n,)
        Cosine of the angle of incidence, the ratio of distance to range; 0 where there is no range.
    jacobian : ndarray, shape (n, FIRST_OWN + KNOTS)
        Derivative of the range, multiplied by the cosine: the range is measured, while the line of sight is known.
    by_time, by_lag : ndarray, shape (n,)
        The same derivative by the time of the messages and by the lag of their headings, at that moment.
    late_s : ndarray, shape (n,)
        Delay with which a scanner that rotates counter-clockwise sees it, relative to the mean.
    face, frame : ndarray of int, shape (n,)
        Part of the outline, and index of the frame.
    share : ndarray, shape (n,)
        Weight of each point, below 1 as its noise is correlated with that of others.
    point : ndarray of int, shape (n,)
        Index of the drive's point; indices after the last point stand for the borders of each frame.
    """

    distance: FloatArray
    variance: FloatArray
    cos: FloatArray
    jacobian: FloatArray
    by_time: FloatArray
    by_lag: FloatArray
    late_s: FloatArray
    face: IntArray
    frame: IntArray
    share: FloatArray
    point: IntArray
