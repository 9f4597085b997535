"""The model of one drive: the distances of its points from the outline, and their derivatives by every parameter.

The wall is the part of the outline at heights where the body is upright; only points whose line of sight meets it are
used. The surface is that of the body. "Face" is the part of the outline that a line of sight meets (`outline.FACES`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.columns import Columns
from laci_stereo.core.estimation import gloss, mixture
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
from laci_stereo.core.estimation.effective_samples import (
    SAME_BORDER_M,
    SAME_ERROR_M,
    blocks_of,
    course_of,
    mean_overlap,
    worth_of,
)
from laci_stereo.core.estimation.evidence import SAME_VIEW_M, Evidence
from laci_stereo.core.frames import FloatArray, IntArray, dot_xy, perpendicular, rotate_xy
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.receiver import KNOTS_PER_TIME, decay, position_sigma_m
from laci_stereo.core.settings import JointSettings, with_turn
from laci_stereo.core.vehicle import outline

BIAS, SWEEP, FOCAL, BASELINE = range(3, 7)
FIRST_OWN = 7
"""Number of the sensor's parameters: yaw, x, y, range bias (in standard deviations of each point), rotation of a
scanner, and the relative amounts by which the focal length and the baseline of a stereo camera are given too small.
They are followed by each drive's own parameters, see `drive_prior`."""

AHEAD = np.array([1.0, 0.0])
"""The sensor's forward axis on the ground plan."""

_NORMAL = slice(1, 3)
"""Columns of the derivatives by x and y, which are the normal in the world frame."""

BY_OPTICS = slice(FOCAL, BASELINE + 1)
"""Focal length and baseline among the parameters and the columns of the derivatives."""

_CLOCK, _HEADING, _LAG, _LEVER, _BEGIN, _GROWTH, _KNOTS = (
    FIRST_OWN + own for own in (CLOCK, HEADING, LAG, LEVER, BEGIN, GROWTH, KNOTS)
)
_SHAPE = slice(FIRST_OWN + SHAPE.start, FIRST_OWN + SHAPE.stop)
_GLOSS = slice(FIRST_OWN + GLOSS.start, FIRST_OWN + GLOSS.stop)
_PARTIAL = FIRST_OWN + PARTIAL

GRAZING = 0.3
"""Least cosine of the angle of incidence in the likelihood of ranges: where a line of sight grazes a corner, not its
angle but the noise of the outline determines how ranges differ, about sqrt(2 x 0.03 m / 0.5 m)."""


@dataclass(frozen=True)
class Fitness:
    """How well a drive fits, at one point in the space of the p parameters.

    Attributes
    ----------
    jacobian, precision : ndarray, shape (n, p) and (n,)
        Derivatives of each point's distance, and its precision, from which the information is computed.
    curvature : ndarray, shape (p, p)
        Of the negative log-likelihood. It uses velocities at the moment itself, and so takes the messages' noise for a
        manoeuvre that would determine the clock offset.
    gradient : ndarray, shape (p,)
        Of the negative log-likelihood.
    scores : ndarray, shape (n, p)
        Contribution of each point to the gradient.
    block : ndarray of int, shape (n,)
        Block of time that each point belongs to.
    log_likelihoods : ndarray, shape (n,)
        Log-likelihoods of the distances.
    log_likelihood : float
        Log-likelihood of all ranges, comparable only with that of the same points.
    shares : ndarray
        Fractions of the mixture, see `mixture.Mixture`.
    weight, squares : float
        Expected number of points of the surface, and the sum of their squared distances.
    explained, rows : float
        Expected number of points that the outline explains, and the number of all points.
    frames : int
        Number of frames with points of the surface.
    """

    jacobian: FloatArray
    precision: FloatArray
    curvature: FloatArray
    gradient: FloatArray
    scores: FloatArray
    block: IntArray
    log_likelihoods: FloatArray
    log_likelihood: float
    shares: FloatArray
    weight: float
    squares: float
    explained: float
    rows: float
    frames: int

    @property
    def information(self) -> FloatArray:
        """The information about the parameters, shape (p, p)."""
        information: FloatArray = (self.jacobian * self.precision[:, None]).T @ self.jacobian
        return information

    def by_block(self) -> tuple[FloatArray, FloatArray]:
        """Return the sum of scores, shape (b, p), and the information, shape (b, p, p), of each of b blocks of time."""
        block = np.unique(self.block, return_inverse=True)[1].reshape(-1)
        count, size = int(block.max(initial=-1)) + 1, self.scores.shape[1]
        scores = np.zeros((count, size))
        np.add.at(scores, block, self.scores)
        parts = [np.flatnonzero(block == one) for one in range(count)]
        told = [(self.jacobian[part] * self.precision[part, None]).T @ self.jacobian[part] for part in parts]
        return scores, np.array(told).reshape(-1, size, size)


@dataclass(frozen=True)
class Met(Columns):
    """What the lines of sight of some points meet on the outline, and where the points are.

    Attributes
    ----------
    points : ndarray of int, shape (n,)
        Indices of the drive's points; indices after the last point stand for the borders of each frame.
    hits : Hits
    arm : ndarray, shape (n, 2)
        Position relative to ``centre``, in the axes of the level frame.
    xy, origin : ndarray, shape (n, 2)
        Point and sensor in the vehicle frame.
    yaw : ndarray, shape (n,)
        Yaw of the body in the world frame.
    """

    points: IntArray
    hits: outline.Hits
    arm: FloatArray
    xy: FloatArray
    origin: FloatArray
    yaw: FloatArray


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


class DriveModel:
    """One drive, with everything that does not depend on the parameters.

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
        passed_s = drive.stamps_s - drive.stamps_s[:1]
        course = drive.way_m / settings.bias_way_m + passed_s / settings.bias_time_s
        end = max(float(course.max(initial=0.0)), 1e-3)
        knots = max(2, int(np.ceil(end * KNOTS_PER_TIME)) + 1)
        at = np.linspace(0.0, end, knots)
        self.hat = np.maximum(0.0, 1.0 - np.abs(course[:, None] - at) / at[1])
        # The last frame is extended to the end of the course, so that no two knots have the same time even in a drive
        # of one frame.
        stays_s, until = (end - course[-1:]) * settings.bias_time_s, np.append(course, end)
        self.knots_s, self.knots_m = (
            np.interp(at, until, np.append(each, each[-1:] + more)) if len(drive) else np.zeros(knots)
            for each, more in ((drive.stamps_s, stays_s), (drive.way_m, 0.0))
        )
        self.block = blocks_of(drive, settings.block_s)
        self.worth = worth_of(drive, SAME_VIEW_M)
        self.borders = np.full((len(drive), 2, 3), np.nan) if drive.borders is None else drive.borders
        self.bordered = bool(np.isfinite(self.borders).any())
        self.error_worth = worth_of(drive, 2.0 * SAME_ERROR_M)  # a triangle with the area of the exponential
        self.border_worth = worth_of(drive, SAME_BORDER_M)
        self.sigma_m = position_sigma_m(drive.vehicle.position_sigma_m, settings)
        self.ends = drive.vehicle.at(drive.stamps_s[[0, -1]])[0] if len(drive) else np.zeros((2, 2))
        clock_sigma_s = with_turn(settings.clock_sigma_s, drive.turn_s) if turns else settings.clock_sigma_s
        drift = self.sigma_m**2 * decay(self.knots_s, self.knots_m, settings)
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

    def shares(self) -> FloatArray:
        """Return the initial fractions of the mixture: of each frame's faces, then of the borders over all frames."""
        of_borders = [mixture.first_shares(outline.BORDERS)] if self.bordered else []
        return np.concatenate([mixture.first_shares(len(self.drive) * outline.FACES), *of_borders])

    def mixed(self, rows: Rows, distance: FloatArray, sigma: FloatArray, shares: FloatArray) -> mixture.Mixture:
        """Weigh distances by their possible sources, separately for faces and borders.

        The mixtures are separate, since what occludes a border is not what lies behind a face.

        Parameters
        ----------
        rows : Rows
            The rows that the distances belong to.
        distance, sigma : ndarray, shape (n,)
            Distances and their standard deviations.
        shares : ndarray
            Fractions, ordered as in the result of `shares`.
        """
        parts = [
            mixture.weigh(distance[part], sigma[part], group, its, rows.share[part])
            for part, group, its in self._kinds(rows, shares)
        ]
        names = ("surface", "behind", "slope", "log_likelihood", "growth")
        whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return mixture.Mixture(**whole, shares=np.concatenate([part.shares for part in parts]))

    def _log_likelihoods(self, rows: Rows, distance: FloatArray, shares: FloatArray) -> FloatArray:
        """Return the log-likelihood of distances of rows, shape (n,), as defined by `mixed`."""
        sigma = np.sqrt(rows.variance)
        return np.concatenate(
            [
                mixture.log_likelihood(distance[part], sigma[part], group, its)
                for part, group, its in self._kinds(rows, shares)
            ]
        )

    def _kinds(self, rows: Rows, shares: FloatArray) -> tuple[tuple[slice, IntArray, FloatArray], ...]:
        """Return the rows of faces and those of borders, each with the rows' groups and the groups' fractions."""
        faces, count = len(self.drive) * outline.FACES, int((rows.face < outline.FACES).sum())
        of_faces = slice(count), rows.frame[:count] * outline.FACES + rows.face[:count], shares[: faces + 1]
        of_borders = slice(count, None), rows.face[count:] - outline.FACES, shares[faces + 1 :]
        return (of_faces, of_borders) if self.bordered else (of_faces,)

    def weigh(self, rows: Rows, softening_m: float, shares: FloatArray) -> Fitness:
        """Return how well the drive fits, given its distances at some parameters.

        The gradient, of shape (FIRST_OWN + own,), treats the noise and the angles of incidence as constants: if they
        were free to change, a side would rotate away from the sensor until its points fit, as their distances are
        shorter than their ranges.

        Parameters
        ----------
        rows : Rows
        softening_m : float
            Standard deviation that is added to the noise.
        shares : ndarray
            Fractions of the mixture, see `mixture.Mixture`.
        """
        sigma = np.sqrt(rows.variance + softening_m**2)
        mixed = self.mixed(rows, rows.distance, sigma, shares)
        weight = rows.share * mixed.surface / (sigma * mixed.growth) ** 2
        jacobian = self._by_all(rows)
        pull = mixed.slope * rows.share
        now = jacobian.copy()
        now[:, _CLOCK] = rows.by_time
        now[:, _LAG] = rows.by_lag
        now[:, SWEEP] = rows.by_time * rows.late_s
        scores = now * pull[:, None]
        of_outline = rows.face < outline.FACES
        surface, behind = mixed.surface * of_outline, mixed.behind * of_outline
        held = np.bincount(rows.frame, surface, len(self.drive)) > 1.0
        return Fitness(
            jacobian=jacobian,
            precision=weight,
            curvature=(now * weight[:, None]).T @ now,
            gradient=scores.sum(axis=0),
            scores=scores,
            block=self.block[rows.frame],
            log_likelihoods=mixed.log_likelihood,
            log_likelihood=float((rows.share * (mixed.log_likelihood + np.log(np.maximum(rows.cos, GRAZING)))).sum()),
            shares=mixed.shares,
            weight=float(surface.sum()),
            squares=float((surface * rows.distance**2).sum()),
            explained=float((surface + behind).sum()),
            rows=float(of_outline.sum()),
            frames=int(held.sum()),
        )

    def lasting(self, rows: Rows, fitness: Fitness) -> FloatArray:
        """Return the covariance of the gradient, shape (p, p), due to matching errors that persist from frame to frame.

        The error that the points on one side of a frame share decays with the distance travelled. Its correlation
        within a frame is included in the points' weights.
        """
        size = fitness.jacobian.shape[1]
        total: FloatArray = np.zeros((size, size))
        if self.drive.window_rad == 0.0 or not len(self.drive.points):
            return total
        way = self.drive.way_m
        alike = np.exp(-np.abs(way[:, None] - way) / SAME_ERROR_M) - np.eye(len(way))
        pulls = fitness.jacobian * (fitness.precision * fitness.jacobian[:, BIAS])[:, None]
        for side in range(outline.SIDES):
            its = rows.face == side
            by_frame = np.zeros((len(way), size))
            np.add.at(by_frame, rows.frame[its], pulls[its])
            total += by_frame.T @ alike @ by_frame
        return self.settings.shared_variance_share * total

    def gain(self, rows: Rows, before: Rows, here: FloatArray, shares: FloatArray) -> float:
        """Return the gain in log-likelihood of the ranges over the previous rows.

        Noise and angles of incidence are held at their previous values. The gain is the quantity whose gradient `weigh`
        returns. It is summed over the points for which the messages determine the vehicle's place both times and which
        stay on their side: where a point changes sides, the likelihood jumps, which no derivative describes.

        Parameters
        ----------
        rows, before : Rows
            Rows at the new and at the previous parameters.
        here : ndarray, shape (n,)
            The `Fitness.log_likelihoods` of the previous rows.
        shares : ndarray
            Fractions of the mixture with which these were weighed.
        """
        if not np.array_equal(rows.point, before.point):
            _, now, then = np.intersect1d(rows.point, before.point, assume_unique=True, return_indices=True)
            rows, before, here = rows[now], before[then], here[then]
        same = rows.face == before.face
        rows, before, here = rows[same], before[same], here[same]
        hit = before.cos > 0.0
        distance = rows.distance * np.where(hit, before.cos, 1.0) / np.where(hit, rows.cos, 1.0)
        there = self._log_likelihoods(before, distance, shares)
        return float(before.share @ (there - here))

    def rows(self, x: FloatArray, chosen: Chosen | None = None) -> Rows:
        """Return the distances at some parameters, of the chosen points, or of the points on the wall there."""
        poses = self._poses(x)
        if not len(self.drive.points):
            return self._centre_rows(x, poses)
        if chosen is None:
            met = self._wall(x, poses)
            share = self._shares(met)
        else:
            known = poses.known[self.drive.frame[chosen.points]]
            met, share = self._meet(x, poses, chosen.points[known]), chosen.share[known]
        rows = self._outline_rows(x, poses, met, share)
        if self.bordered and len(rows.frame):  # without points of the outline, borders may be those of anything
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
        met = self._wall(x, poses)
        return Chosen(met.points, self._shares(met), poses.unsure)

    def wall(self, x: FloatArray) -> Met:
        """Return what the lines of sight meet on the wall, in frames where the messages determine the pose."""
        return self._wall(x, self._poses(x))

    def _wall(self, x: FloatArray, poses: Poses) -> Met:
        met = self._meet(x, poses, np.flatnonzero(poses.known[self.drive.frame]))
        z, sigma_z = self.drive.points[met.points, 2], self.drive.sigma_z_m[met.points]
        blur_m = self.drive.blur_m[met.points]
        ahead_m = outline.about_middle(x[_SHAPE])[0][0]
        matched, behind_m = self.drive.window_rad > 0.0, self.size[0] / 2 + ahead_m - met.xy[:, 0]
        highest_m = outline.highest_of(self.size[1], met.hits.face, behind_m, matched=matched)
        return met[outline.on_the_wall(self.drive.height_m, z, met.hits, sigma_z, blur_m, highest_m)]

    def _shares(self, met: Met) -> FloatArray:
        drive, points, face = self.drive, met.points, met.hits.face
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

    def _by_all(self, rows: Rows) -> FloatArray:
        """Append the derivatives by the knots: a bias of the messages' positions shifts the vehicle in the world."""
        hat = self.hat[rows.frame]
        return np.hstack([rows.jacobian, rows.jacobian[:, 1:2] * hat, rows.jacobian[:, 2:3] * hat])

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
        count = len(self.knots_s)
        bias = np.column_stack([self.hat @ x[_KNOTS : _KNOTS + count], self.hat @ x[_KNOTS + count :]])
        yaw = poses.yaw
        shift = x[1:3] + bias - poses.xy
        xy = rotate_xy(-yaw[frame], rotate_xy(x[0], arm) + shift[frame])
        origin = rotate_xy(-yaw, rotate_xy(x[0], -self.centre * _scale(x)) + shift)
        return xy, origin[frame], yaw[frame]

    def _meet(self, x: FloatArray, poses: Poses, points: IntArray) -> Met:
        along = self.drive.sigma_along_m[points]
        frame = self.drive.frame[points]
        arm = (self.drive.points[points, :2] - self.centre) * _scale(x) - x[BIAS] * along[:, None] * self.sight[points]
        late_s = x[SWEEP] * self.drive.points_late_s[points]
        moved = late_s[:, None] * rotate_xy(-x[0], poses.rates.velocity)[frame]
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm - moved)
        across = self.drive.sigma_across_m[points]
        z = self.drive.points[points, 2]
        hits = outline.meet(xy, origin, along, across, self.size, x[_SHAPE], z)
        return Met(points, hits, arm, xy, origin, yaw)

    def _outline_rows(self, x: FloatArray, poses: Poses, met: Met, share: FloatArray) -> Rows:
        drive, points, frame = self.drive, met.points, self.drive.frame[met.points]
        late_s = drive.frames_late_s[frame] + drive.points_late_s[points]
        rows = self._rows_of(x, poses, met, frame, late_s, share)
        towards = dot_xy(rotate_xy(x[0], self.sight[points]), rows.jacobian[:, _NORMAL])
        # The optics scale the measured range, which includes its noise, not the range to the side: add the difference
        # along the line of sight.
        sight, ahead_m = self.sight[points], drive.points[points, 0]
        longer = np.column_stack([sight[:, 0] * ahead_m, dot_xy(sight, drive.points[points, :2])])
        rows.jacobian[:, BY_OPTICS] += ((1.0 - met.hits.reach) * towards)[:, None] * longer
        rows.jacobian[:, BIAS] = -drive.sigma_along_m[points] * towards
        # A point that is seen within half a window of a border may be the border's. This adds to its variance fully
        # beside the outline, and also on a side that looks narrower than half a window, as it is grazed.
        window_m = self._window_m(np.hypot(*drive.points[points, :2].T))
        aside_m = BORDER_SIGMA * window_m * (2.0 * met.hits.within < window_m)
        rows = replace(rows, variance=rows.variance + (1.0 - met.hits.cos**2) * aside_m**2)
        if drive.window_rad == 0.0:
            return rows
        mirrored = gloss.mirrored(met.hits.cos * np.cos(drive.above_rad[points]))
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
        frame, side = np.nonzero(np.isfinite(self.borders[:, :, 0]) & poses.known[:, None])
        at = self.borders[frame, side, :2]
        arm = (at - self.centre) * _scale(x)
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm)
        hits = outline.touch(xy, origin, side > 0, self.size, x[_SHAPE])
        window_m = self._window_m(hits.reach * np.hypot(*at.T))
        met = Met(len(self.drive.points) + 2 * frame + side, hits, arm, xy, origin, yaw)
        rows = self._rows_of(x, poses, met, frame, self.drive.frames_late_s[frame], self.border_worth[frame])
        rows.jacobian[np.arange(len(frame)), _GROWTH + side] = -window_m
        return replace(
            rows,
            distance=rows.distance - window_m * x[_GROWTH + side],
            variance=rows.variance + (BORDER_SIGMA * window_m) ** 2,
        )

    def _rows_of(
        self, x: FloatArray, poses: Poses, met: Met, frame: IntArray, late_s: FloatArray, share: FloatArray
    ) -> Rows:
        hits = met.hits
        # Derivatives are taken where the line of sight meets the side: a point that noise has displaced would have
        # those of another place.
        from_sensor = self.centre * _scale(x)
        arm = (met.arm + from_sensor) * hits.reach[:, None] - from_sensor
        xy = met.origin + (met.xy - met.origin) * hits.reach[:, None]
        jacobian = self._jacobian(x, poses, frame, late_s, arm, xy, met.yaw, hits.normal)
        jacobian[:, _SHAPE] = hits.by_shape
        jacobian[:, BY_OPTICS] = _by_optics(x, jacobian[:, _NORMAL], arm)
        return Rows(
            distance=hits.distance,
            variance=hits.variance,
            cos=hits.cos,
            jacobian=jacobian,
            by_time=by_time(poses.now, frame, xy, hits.normal, jacobian[:, _NORMAL]),
            by_lag=poses.now.yaw[frame] * jacobian[:, _HEADING],
            late_s=late_s,
            face=hits.face,
            frame=frame,
            share=share,
            point=met.points,
        )

    def _centre_rows(self, x: FloatArray, poses: Poses) -> Rows:
        """Return how far a detector's box centres are from the vehicle's, along and across the vehicle.

        A part of their errors persists while the vehicle is seen from one side, so that many weigh no more than a few
        (Kish's design effect, as in `choose`); this fraction is estimated from the boxes.
        """
        frame = np.flatnonzero(poses.known)
        arm = (self.drive.middles[frame] - self.centre) * _scale(x)
        late_s = self.drive.frames_late_s[frame]
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm)
        middle, _ = outline.about_middle(x[_SHAPE])
        nearer = np.sign(origin - middle) * self.drive.lacking_m[frame] / 2
        distances = (xy - middle - x[_PARTIAL] * nearer).T
        worth = self.error_worth[frame]
        variances, lasting = course_of(distances, self.drive.way_m[frame], worth)
        variances = np.maximum(variances, outline.OUTLINE_SIGMA_M**2)
        parts = []
        by_shape = np.zeros((2, len(outline.SHAPE)))
        by_shape[0, :2], by_shape[1, 3] = (0.5, -0.5), 1.0
        for axis, moved in enumerate(by_shape):
            normal = np.tile(np.eye(2)[axis], (len(frame), 1))
            jacobian = self._jacobian(x, poses, frame, late_s, arm, xy, yaw, normal)
            jacobian[:, _SHAPE] = -moved
            jacobian[:, _PARTIAL] = -nearer[:, axis]
            parts.append(
                Rows(
                    distance=distances[axis],
                    variance=np.full(len(frame), variances[axis]),
                    cos=np.ones(len(frame)),
                    jacobian=jacobian,
                    by_time=by_time(poses.now, frame, xy, normal, jacobian[:, _NORMAL]),
                    by_lag=poses.now.yaw[frame] * jacobian[:, _HEADING],
                    late_s=late_s,
                    face=np.full(len(frame), axis),
                    frame=frame,
                    share=1.0 / (1.0 + (1.0 / worth - 1.0) * lasting[axis]),
                    point=frame + axis * len(self.drive),
                )
            )
        return parts[0].joined(*parts[1:])

    def _jacobian(
        self,
        x: FloatArray,
        poses: Poses,
        frame: IntArray,
        late_s: FloatArray,
        arm: FloatArray,
        xy: FloatArray,
        yaw: FloatArray,
        normal: FloatArray,
    ) -> FloatArray:
        """Return the derivatives of normal . xy, shape (n, FIRST_OWN + KNOTS).

        They are those by yaw, x, y, rotation of the scanner, clock offset, heading error and lag, heading lever and
        initial angle of the body; the other columns are 0.
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
        return jacobian


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
