"""The model of one drive: the distances of its points from the outline, and their derivatives by every parameter.

The wall is the part of the outline at heights where the body is upright; only points whose line of sight meets it are
used. The surface is that of the body.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.core.estimation import gloss
from laci_stereo.core.estimation.drive_likelihood import DriveLikelihood
from laci_stereo.core.estimation.drive_poses import Poses, by_time, heading_noise, poses_at
from laci_stereo.core.estimation.drive_prior import (
    BEGIN,
    BORDER_SIGMA,
    CLOCK,
    GLOSS,
    GROWTH,
    HEADING,
    KNOTS,
    LAG,
    LEVER,
    PARTIAL,
    SHAPE,
    DrivePrior,
)
from laci_stereo.core.estimation.drive_rows import (
    APART,
    BASELINE,
    BIAS,
    BY_OPTICS,
    FIRST_OWN,
    FOCAL,
    SWEEP,
    Chosen,
    Rows,
    SightLines,
)
from laci_stereo.core.estimation.effective_samples import (
    SAME_BORDER_M,
    SAME_ERROR_M,
    course_of,
    mean_overlap,
    worth_of,
)
from laci_stereo.core.estimation.evidence import SAME_VIEW_M, Evidence
from laci_stereo.core.estimation.position_knots import knots_of
from laci_stereo.core.frames import FloatArray, IntArray, dot_xy, perpendicular, rotate_xy
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.receiver import decay, position_sigma_m
from laci_stereo.core.settings import JointSettings, with_turn
from laci_stereo.core.vehicle import outline

AHEAD = np.array([1.0, 0.0])
"""The sensor's forward axis on the ground plan."""

_NORMAL = slice(1, 3)
"""Columns of the derivatives by x and y, which are the normal in the world frame."""

_CLOCK, _HEADING, _LAG, _LEVER, _BEGIN, _GROWTH, _KNOTS = (
    FIRST_OWN + own for own in (CLOCK, HEADING, LAG, LEVER, BEGIN, GROWTH, KNOTS)
)
_SHAPE = slice(FIRST_OWN + SHAPE.start, FIRST_OWN + SHAPE.stop)
_GLOSS = slice(FIRST_OWN + GLOSS.start, FIRST_OWN + GLOSS.stop)
_PARTIAL = FIRST_OWN + PARTIAL


class DriveModel:
    """The geometry of one drive, with everything that does not depend on the parameters.

    Parameters
    ----------
    drive : Evidence
    centre : ndarray, shape (2,)
        Place of the level frame to which yaw and position refer.
    settings : JointSettings
    turns : bool
        The scanner may rotate without reporting the points' times.
    """

    def __init__(self, drive: Evidence, centre: FloatArray, settings: JointSettings, *, turns: bool = False) -> None:
        self.drive = drive
        self.centre = centre
        self.settings = settings
        self.size = (drive.vehicle.length_m, drive.vehicle.width_m)
        self.knots = knots_of(drive, settings)
        self.likelihood = DriveLikelihood(drive, self.knots.hat, settings)
        self.worth = worth_of(drive, SAME_VIEW_M)
        self.error_worth = worth_of(drive, 2.0 * SAME_ERROR_M)  # a triangle with the area of the exponential
        self.border_worth = worth_of(drive, SAME_BORDER_M)
        self.sigma_m = position_sigma_m(drive.vehicle.position_sigma_m, settings)
        self.ends = drive.vehicle.at(drive.stamps_s[[0, -1]])[0] if len(drive) else np.zeros((2, 2))
        clock_sigma_s = with_turn(settings.clock_sigma_s, drive.turn_s) if turns else settings.clock_sigma_s
        drift = self.sigma_m**2 * decay(self.knots.at_s, self.knots.at_m, settings)
        self.prior = DrivePrior(drive.vehicle, drift, clock_sigma_s, settings)
        self.frame_s = max(float(np.median(np.diff(drive.stamps_s))), 1e-9) if len(drive) > 1 else np.inf
        self.heading_variance = _heading_variance(drive, self.frame_s, np.radians(settings.heading_sigma_deg))
        range_m = np.linalg.norm(drive.points[:, :2], axis=1)
        self.sight = drive.points[:, :2] / np.maximum(range_m, 1e-9)[:, None]

    def body(self, own: FloatArray) -> VehicleTrack:
        """Return the vehicle's track with the yaw of its body, given the drive's own parameters.

        The messages report the direction of motion, often that of the front, which differs from the body's in a bend.
        """
        vehicle = self.drive.vehicle
        heading_error, lever, begin, lag_s = own[[HEADING, LEVER, BEGIN, LAG]].tolist()
        poses = poses_at(vehicle.stamps_s, vehicle, heading_error, lever, begin, lag_s)
        yaw = vehicle.yaw_rad + np.where(poses.known, poses.yaw - poses.heading, 0.0)
        reference = np.tile(np.asarray(vehicle.reference), (len(yaw), 1))
        xy = vehicle.xy + rotate_xy(vehicle.yaw_rad, reference) - rotate_xy(yaw, reference)
        return replace(vehicle, xy=xy, yaw_rad=yaw)

    def rows(self, x: FloatArray, chosen: Chosen | None = None) -> Rows:
        """Return the distances at some parameters, of the chosen points, or of the points on the wall there."""
        poses = self._poses(x)
        if not len(self.drive.points):
            return self._centre_rows(x, poses)
        if chosen is None:
            lines = self._wall(x, poses)
            share = self._shares(lines)
        else:
            known = poses.known[self.drive.frame[chosen.points]]
            lines, share = self._sight_lines(x, poses, chosen.points[known]), chosen.share[known]
        rows = self._outline_rows(x, poses, lines, share)
        # Without points of the outline, borders may be those of anything.
        if self.drive.has_borders and len(rows.frame):
            rows = rows.joined(self._border_rows(x, poses))
        # All points of a frame share the error of its heading. Multiplied by the sum of their weights, its variance
        # gives them together the information of one point with this error.
        each_frame = self.heading_variance + (poses if chosen is None else chosen).unsure / self.frame_s
        by_heading = (each_frame * np.bincount(rows.frame, rows.share, len(each_frame)))[rows.frame]
        return replace(rows, variance=rows.variance + by_heading * rows.jacobian[:, _HEADING] ** 2)

    def choose(self, x: FloatArray) -> Chosen:
        """Return the points that meet the wall at some parameters, and the weight of each.

        Points on one side in one frame share a part of their noise, and points in one matching window share all of it,
        so that many points weigh no more than a few (Kish's design effect, 1 + (n - 1) rho). Points whose lines of
        sight pass by the outline are counted with the side that has most points in the frame.
        """
        poses = self._poses(x)
        lines = self._wall(x, poses)
        return Chosen(lines.points, self._shares(lines), poses.unsure)

    def wall(self, x: FloatArray) -> SightLines:
        """Return what the lines of sight meet on the wall, in frames where the messages determine the pose."""
        return self._wall(x, self._poses(x))

    def _wall(self, x: FloatArray, poses: Poses) -> SightLines:
        lines = self._sight_lines(x, poses, np.flatnonzero(poses.known[self.drive.frame]))
        sigma_z = self.drive.sigma_z_m[lines.points]
        blur_m = self.drive.blur_m[lines.points]
        ahead_m = outline.about_middle(x[_SHAPE])[0][0]
        matched, behind_m = self.drive.window_rad > 0.0, self.size[0] / 2 + ahead_m - lines.xy[:, 0]
        highest_m = outline.highest_of(self.size[1], lines.hits.face, behind_m, matched=matched)
        return lines[outline.on_the_wall(self.drive.height_m, lines.z, lines.hits, sigma_z, blur_m, highest_m)]

    def _shares(self, lines: SightLines) -> FloatArray:
        drive, points, face = self.drive, lines.points, lines.hits.face
        together = np.zeros((len(drive), outline.FACES))
        np.add.at(together, (drive.frame[points], face), 1.0)
        side = np.where(face < outline.SIDES, face, together[:, : outline.SIDES].argmax(axis=1)[drive.frame[points]])
        group = drive.frame[points] * outline.SIDES + side
        count = np.bincount(group)[group]
        return self.worth[drive.frame[points]] / (1.0 + (count - 1.0) * self._in_common(points, group))

    def _in_common(self, points: IntArray, group: IntArray) -> FloatArray:
        """Return the fraction of its variance that each point shares with others of its group, on average, shape (n,).

        Two windows that overlap share the same fraction of their noise as of their pixels.
        """
        shared, drive = self.settings.shared_variance_share, self.drive
        if drive.window_rad == 0.0 or not len(points):
            return np.full(len(points), shared)
        overlap = np.ones(len(points))
        for seen_rad in (drive.beside_rad[points], drive.above_rad[points]):
            least, most = np.full((2, int(group.max()) + 1), np.inf)
            np.minimum.at(least, group, seen_rad)
            np.minimum.at(most, group, -seen_rad)
            overlap *= mean_overlap((-most - least)[group] / drive.window_rad)
        return shared + (1.0 - shared) * overlap

    def _poses(self, x: FloatArray) -> Poses:
        at = self.drive.stamps_s + x[_CLOCK] + x[SWEEP] * self.drive.frames_late_s
        return poses_at(at, self.drive.vehicle, x[_HEADING], x[_LEVER], x[_BEGIN], x[_LAG])

    def _into_vehicle(
        self, x: FloatArray, poses: Poses, frame: IntArray, arm: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Map points, given relative to ``centre`` in the axes of the level frame, into the vehicle frame.

        Returns
        -------
        xy : ndarray, shape (n, 2)
        origin : ndarray, shape (n, 2)
            The sensor.
        yaw : ndarray, shape (n,)
            Yaw of the body in the world frame.
        """
        hat, count = self.knots.hat, len(self.knots)
        bias = np.column_stack([hat @ x[_KNOTS : _KNOTS + count], hat @ x[_KNOTS + count :]])
        yaw = poses.yaw
        shift = x[1:3] + bias - poses.xy
        xy = rotate_xy(-yaw[frame], rotate_xy(x[0], arm) + shift[frame])
        origin = rotate_xy(-yaw, rotate_xy(x[0], -self.centre * _scale(x)) + shift)
        return xy, origin[frame], yaw[frame]

    def _sight_lines(self, x: FloatArray, poses: Poses, points: IntArray) -> SightLines:
        along = self.drive.sigma_along_m[points]
        frame = self.drive.frame[points]
        arm = (self.drive.points[points, :2] - self.centre) * _scale(x) - x[BIAS] * along[:, None] * self.sight[points]
        late_s = x[SWEEP] * self.drive.points_late_s[points]
        moved = late_s[:, None] * rotate_xy(-x[0], poses.rates.velocity)[frame]
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm - moved)
        z, farther = self.drive.points[points, 2], np.zeros(len(points))
        if self.drive.cameras is not None:
            farther = self._farther_per_s(x, poses, points, xy, yaw)
            nearer = x[APART] * farther
            arm = arm - nearer[:, None] * self.drive.points[points, :2]
            xy = xy - nearer[:, None] * (xy - origin)
            z = z - nearer * (z - self.drive.height_m)
        across = self.drive.sigma_across_m[points]
        hits = outline.meet(xy, origin, along, across, self.size, x[_SHAPE], z)
        return SightLines(points, hits, arm, xy, z, origin, yaw, farther)

    def _farther_per_s(
        self, x: FloatArray, poses: Poses, points: IntArray, xy: FloatArray, yaw: FloatArray
    ) -> FloatArray:
        """Return by which fraction points are measured too far per second between left and right images, (n,)."""
        frame = self.drive.frame[points]
        turning = rotate_xy(yaw, poses.rates.yaw[frame, None] * perpendicular(xy))
        return dot_xy(self.drive.farther_per_m[points], rotate_xy(-x[0], poses.rates.velocity[frame] + turning))

    def _outline_rows(self, x: FloatArray, poses: Poses, lines: SightLines, share: FloatArray) -> Rows:
        drive, points, frame = self.drive, lines.points, self.drive.frame[lines.points]
        late_s = drive.frames_late_s[frame] + drive.points_late_s[points]
        rows = self._rows_of(x, poses, lines, frame, late_s, share)
        towards = dot_xy(rotate_xy(x[0], self.sight[points]), rows.jacobian[:, _NORMAL])
        # The optics scale the measured range, which includes its noise, not the range to the side: add the difference
        # along the line of sight.
        sight, ahead_m = self.sight[points], drive.points[points, 0]
        longer = np.column_stack([sight[:, 0] * ahead_m, dot_xy(sight, drive.points[points, :2])])
        rows.jacobian[:, BY_OPTICS] += ((1.0 - lines.hits.reach) * towards)[:, None] * longer
        rows.jacobian[:, BIAS] = -drive.sigma_along_m[points] * towards
        rows.jacobian[:, APART] = -lines.farther * np.hypot(*drive.points[points, :2].T) * towards
        # A point that is seen within half a window of a border may be the border's. This adds to its variance fully
        # beside the outline, and also on a side that looks narrower than half a window, as it is grazed.
        window_m = self._window_m(np.hypot(*drive.points[points, :2].T))
        aside_m = BORDER_SIGMA * window_m * (2.0 * lines.hits.within < window_m)
        rows = replace(rows, variance=rows.variance + (1.0 - lines.hits.cos**2) * aside_m**2)
        if drive.window_rad == 0.0:
            return rows
        mirrored = gloss.mirrored(lines.hits.cos * np.cos(drive.above_rad[points]))
        rows.jacobian[:, _GLOSS] = mirrored * rows.jacobian[:, [BIAS]]
        return replace(rows, distance=rows.distance + rows.jacobian[:, _GLOSS] @ x[_GLOSS])

    def _window_m(self, range_m: FloatArray) -> FloatArray:
        """Return the width of a matching window at distances on the ground plan, shape (n,), metres."""
        window_m: FloatArray = self.drive.window_rad * np.hypot(range_m, self.drive.height_m)
        return window_m

    def _border_rows(self, x: FloatArray, poses: Poses) -> Rows:
        """Return how far the outermost lines of sight miss the outline's borders, beyond the growth of these borders.

        Where something occludes a border, the visible part ends inside it, as a point behind the surface lies inside.
        """
        borders = self.drive.borders
        frame, side = np.nonzero(np.isfinite(borders[:, :, 0]) & poses.known[:, None])
        at, z = borders[frame, side, :2], borders[frame, side, 2]
        arm = (at - self.centre) * _scale(x)
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm)
        hits = outline.touch(xy, origin, side > 0, self.size, x[_SHAPE])
        window_m = self._window_m(hits.reach * np.hypot(*at.T))
        index, farther = len(self.drive.points) + 2 * frame + side, np.zeros(len(frame))
        lines = SightLines(index, hits, arm, xy, z, origin, yaw, farther)
        rows = self._rows_of(x, poses, lines, frame, self.drive.frames_late_s[frame], self.border_worth[frame])
        rows.jacobian[np.arange(len(frame)), _GROWTH + side] = -window_m
        return replace(
            rows,
            distance=rows.distance - window_m * x[_GROWTH + side],
            variance=rows.variance + (BORDER_SIGMA * window_m) ** 2,
        )

    def _rows_of(
        self, x: FloatArray, poses: Poses, lines: SightLines, frame: IntArray, late_s: FloatArray, share: FloatArray
    ) -> Rows:
        hits = lines.hits
        # Derivatives are taken where the line of sight meets the side: a point that noise has displaced would have
        # those of another place.
        from_sensor = self.centre * _scale(x)
        arm = (lines.arm + from_sensor) * hits.reach[:, None] - from_sensor
        xy = lines.origin + (lines.xy - lines.origin) * hits.reach[:, None]
        jacobian, by_now, by_lag = self._derivatives(x, poses, frame, late_s, arm, xy, lines.yaw, hits.normal)
        jacobian[:, _SHAPE] = hits.by_shape
        jacobian[:, BY_OPTICS] = _by_optics(x, jacobian[:, _NORMAL], arm)
        return Rows(
            distance=hits.distance,
            variance=hits.variance,
            cos=hits.cos,
            jacobian=jacobian,
            by_time=by_now,
            by_lag=by_lag,
            late_s=late_s,
            face=hits.face,
            frame=frame,
            share=share,
            point=lines.points,
        )

    def _centre_rows(self, x: FloatArray, poses: Poses) -> Rows:
        """Return how far a detector's box centres are from the vehicle's, along and across the vehicle.

        A part of their errors persists while the vehicle is seen from one side, so that many weigh no more than a few
        (Kish's design effect, as in `choose`); this fraction is estimated from the boxes. All share an error along the
        line of sight, which is the range bias.
        """
        frame = np.flatnonzero(poses.known)
        arm = (self.drive.middles[frame] - self.centre) * _scale(x)
        late_s = self.drive.frames_late_s[frame]
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm)
        middle, _ = outline.about_middle(x[_SHAPE])
        nearer = np.sign(origin - middle) * np.maximum(self.drive.lacking_m[frame], 0.0) / 2
        sight = (xy - origin) / np.maximum(np.linalg.norm(xy - origin, axis=1, keepdims=True), 1e-9)
        farther = self.settings.boxes_range_m / self.settings.bias_noise_share * sight
        distances = (xy - middle - x[_PARTIAL] * nearer + x[BIAS] * farther).T
        worth = self.error_worth[frame]
        variances, lasting = course_of(distances, self.drive.way_m[frame], worth)
        variances = np.maximum(variances, outline.OUTLINE_SIGMA_M**2)
        parts = []
        by_shape = np.zeros((2, len(outline.SHAPE)))
        by_shape[0, :2], by_shape[1, 3] = (0.5, -0.5), 1.0
        for axis, moved in enumerate(by_shape):
            normal = np.tile(np.eye(2)[axis], (len(frame), 1))
            jacobian, by_now, by_lag = self._derivatives(x, poses, frame, late_s, arm, xy, yaw, normal)
            jacobian[:, _SHAPE] = -moved
            jacobian[:, _PARTIAL] = -nearer[:, axis]
            jacobian[:, BIAS] = farther[:, axis]
            parts.append(
                Rows(
                    distance=distances[axis],
                    variance=np.full(len(frame), variances[axis]),
                    cos=np.ones(len(frame)),
                    jacobian=jacobian,
                    by_time=by_now,
                    by_lag=by_lag,
                    late_s=late_s,
                    face=np.full(len(frame), axis),
                    frame=frame,
                    share=1.0 / (1.0 + (1.0 / worth - 1.0) * lasting[axis]),
                    point=frame + axis * len(self.drive),
                )
            )
        return parts[0].joined(*parts[1:])

    def _derivatives(
        self,
        x: FloatArray,
        poses: Poses,
        frame: IntArray,
        late_s: FloatArray,
        arm: FloatArray,
        xy: FloatArray,
        yaw: FloatArray,
        normal: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the derivatives of normal . xy: `Rows.jacobian`, `Rows.by_time` and `Rows.by_lag`.

        The jacobian's are those by yaw, x, y, rotation of the scanner, clock offset, heading error and lag, heading
        lever and initial angle of the body; the other columns are 0.
        """
        jacobian = np.zeros((len(xy), _KNOTS))
        normal_world = rotate_xy(yaw, normal)
        jacobian[:, 0] = dot_xy(normal_world, perpendicular(rotate_xy(x[0], arm)))
        jacobian[:, _NORMAL] = normal_world
        jacobian[:, _CLOCK] = by_time(poses.rates, frame, xy, normal, normal_world)
        jacobian[:, SWEEP] = late_s * jacobian[:, _CLOCK]
        about = -dot_xy(normal, perpendicular(xy - np.asarray(self.drive.vehicle.reference)))
        jacobian[:, _HEADING] = about
        jacobian[:, _LAG] = about * poses.rates.yaw[frame]
        jacobian[:, _LEVER] = about * poses.by_lever[frame]
        jacobian[:, _BEGIN] = about * poses.by_begin[frame]
        return jacobian, by_time(poses.now, frame, xy, normal, normal_world), about * poses.now.yaw[frame]


def _scale(x: FloatArray) -> FloatArray:
    """Return the factors by which the optics scale points ahead of a stereo camera and to its side, shape (2,).

    The optics are its focal length and its baseline. Depth is focal length times baseline over disparity; across the
    axis the focal length cancels out. For a camera that looks down, the effect of the focal length on the ground plan
    is smaller, by the squared cosine of its pitch, as the estimated ground tilts with it.
    """
    scale: FloatArray = 1.0 + x[BASELINE] + x[FOCAL] * AHEAD
    return scale


def _by_optics(x: FloatArray, normal_world: FloatArray, arm: FloatArray) -> FloatArray:
    """Return the derivatives of points' positions along their normals by focal length and baseline, shape (n, 2)."""
    normal, told = rotate_xy(-x[0], normal_world), arm / _scale(x)
    return np.column_stack([dot_xy(normal, told * AHEAD), dot_xy(normal, told)])


def _heading_variance(drive: Evidence, frame_s: float, otherwise_rad: float) -> float:
    """Return the variance of each frame's yaw that results from the noise of the messages' headings, rad^2.

    All frames until the next message share the error of one message. In order that these frames together carry the
    information of one message, its variance is multiplied by their number. Smoothing does not change this: it makes
    errors smaller but common to more frames.
    """
    message_s = float(np.median(np.diff(drive.vehicle.stamps_s)))
    return heading_noise(drive.vehicle, otherwise_rad) ** 2 * max(1.0, message_s / frame_s)
