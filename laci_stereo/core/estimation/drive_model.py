"""The model of one drive: how far its points are from the outline, and what every parameter does to that."""

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
"""Yaw, x, y, the range bias, how it turns, and by which share a stereo camera's focal length and baseline are taken too
short are the sensor's; what follows is each drive's own, see `drive_prior`."""

AHEAD = np.array([1.0, 0.0])
"""The sensor's forward axis on the ground plan."""

_NORMAL = slice(1, 3)
"""The derivatives by x and y: where the normal points on the map."""

BY_OPTICS = slice(FOCAL, BASELINE + 1)
"""The derivatives by both, and where they are among the parameters."""

_CLOCK, _HEADING, _LEVER, _BEGIN, _GROWTH, _KNOTS = (
    FIRST_OWN + own for own in (CLOCK, HEADING, LEVER, BEGIN, GROWTH, KNOTS)
)
_SHAPE = slice(FIRST_OWN + SHAPE.start, FIRST_OWN + SHAPE.stop)
_GLOSS = slice(FIRST_OWN + GLOSS.start, FIRST_OWN + GLOSS.stop)
_PARTIAL = FIRST_OWN + PARTIAL

GRAZING = 0.3
"""Where rays touch a corner, its noise, not their angle, tells how ranges differ: about sqrt(2 x 0.03 m / 0.5 m)."""


@dataclass(frozen=True)
class Fitness:
    """How well a drive fits, at one point in the space of parameters.

    Attributes
    ----------
    jacobian, precision : ndarray, shape (n, p) and (n,)
        Of each point, as what is known is told by.
    curvature : ndarray, shape (p, p)
        Of the negative log-likelihood; it takes the messages' noise for a manoeuvre that tells the clocks' offset.
    gradient : ndarray, shape (p,)
        Of the negative log-likelihood.
    scores : ndarray, shape (n, p)
        The gradient, by points.
    block : ndarray of int, shape (n,)
        In which block of time each is.
    log_likelihoods : ndarray, shape (n,)
        Of the distances.
    log_likelihood : float
        Of the ranges; it can be compared with that of the same points only.
    shares : ndarray
        See `mixture.Mixture`.
    weight, squares : float
        Of the points of the surface, and the sum of their squared distances.
    explained, rows : float
        Points that the outline explains, and all.
    frames : int
        With points of the surface.
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
        """What is known, shape (p, p)."""
        information: FloatArray = (self.jacobian * self.precision[:, None]).T @ self.jacobian
        return information

    def by_block(self) -> tuple[FloatArray, FloatArray]:
        """Return of each block of time the sum of its scores, shape (b, p), and what it tells, shape (b, p, p)."""
        block = np.unique(self.block, return_inverse=True)[1].reshape(-1)
        count, size = int(block.max(initial=-1)) + 1, self.scores.shape[1]
        scores = np.zeros((count, size))
        np.add.at(scores, block, self.scores)
        parts = [np.flatnonzero(block == one) for one in range(count)]
        told = [(self.jacobian[part] * self.precision[part, None]).T @ self.jacobian[part] for part in parts]
        return scores, np.array(told).reshape(-1, size, size)


@dataclass(frozen=True)
class Met(Columns):
    """What the lines of sight of some points meet, and where the points are.

    Attributes
    ----------
    points : ndarray of int, shape (n,)
        Which of the drive's; behind them are the borders of each frame.
    hits : Hits
    arm : ndarray, shape (n, 2)
        From ``centre``, in level axes.
    xy, origin : ndarray, shape (n, 2)
        Point and sensor in the vehicle frame.
    yaw : ndarray, shape (n,)
        Of the body.
    """

    points: IntArray
    hits: outline.Hits
    arm: FloatArray
    xy: FloatArray
    origin: FloatArray
    yaw: FloatArray


@dataclass(frozen=True)
class Chosen:
    """The points that are held against the outline.

    Attributes
    ----------
    points : ndarray of int, shape (n,)
        Which of the drive's.
    share : ndarray, shape (n,)
        How much each weighs, since it shares its noise with others.
    unsure : ndarray, shape (m,)
        See `Poses`, of each frame: it must not change on the way, as weights must not.
    """

    points: IntArray
    share: FloatArray
    unsure: FloatArray


@dataclass(frozen=True)
class Rows(Columns):
    """Distances from the outline, borders' last, with their derivatives by the first parameters, up to the knots.

    Attributes
    ----------
    distance, variance : ndarray, shape (n,)
    cos : ndarray, shape (n,)
        By which ranges are longer than distances; 0 where there is no range.
    jacobian : ndarray, shape (n, 24)
        Of the range, times the cosine: what is measured is the range, while the line of sight is known.
    by_time : ndarray, shape (n,)
        The same by the time of the messages, at that moment.
    late_s : ndarray, shape (n,)
        How much later than in the mean a scanner that turns counter-clockwise sees it.
    face, frame : ndarray of int, shape (n,)
    share : ndarray, shape (n,)
        How much each weighs, since it shares its noise with others.
    point : ndarray of int, shape (n,)
        Which of the drive's it is of; behind them are the borders of each frame.
    """

    distance: FloatArray
    variance: FloatArray
    cos: FloatArray
    jacobian: FloatArray
    by_time: FloatArray
    late_s: FloatArray
    face: IntArray
    frame: IntArray
    share: FloatArray
    point: IntArray


class DriveModel:
    """One drive, with what does not change while the parameters do.

    Parameters
    ----------
    drive : Evidence
    centre : ndarray, shape (2,)
        Level, about which yaw and position are meant.
    settings : JointSettings
    turns : bool
        The scanner may turn without telling the points' times.
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
        # What lasts for one frame stands on until then, so that no two knots are at one time.
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
        """Return the vehicle's track with the yaw of its body, as the drive's own parameters have it.

        What is told is that of its motion, often of its front's, which differs in a bend.
        """
        vehicle = self.drive.vehicle
        heading_error, lever, begin = own[[HEADING, LEVER, BEGIN]].tolist()
        poses = poses_at(vehicle.stamps_s, vehicle, heading_error, lever, begin)
        yaw = vehicle.yaw_rad + np.where(poses.known, poses.yaw - poses.heading, 0.0)
        reference = np.tile(np.asarray(vehicle.reference), (len(yaw), 1))
        xy = vehicle.xy + rotate_xy(vehicle.yaw_rad, reference) - rotate_xy(yaw, reference)
        return replace(vehicle, xy=xy, yaw_rad=yaw)

    def shares(self) -> FloatArray:
        """Return the mixture's shares to begin with: of each frame's faces, then of the borders of all frames."""
        of_borders = [mixture.first_shares(outline.BORDERS)] if self.bordered else []
        return np.concatenate([mixture.first_shares(len(self.drive) * outline.FACES), *of_borders])

    def mixed(self, rows: Rows, distance: FloatArray, sigma: FloatArray, shares: FloatArray) -> mixture.Mixture:
        """Weigh distances by what they can come from; what hides a border is another thing than what is behind a face.

        Parameters
        ----------
        rows : Rows
            Whose distances they are.
        distance, sigma : ndarray, shape (n,)
        shares : ndarray
            As `shares` has them.
        """
        parts = [
            mixture.weigh(distance[part], sigma[part], group, its, rows.share[part])
            for part, group, its in self._kinds(rows, shares)
        ]
        names = ("surface", "behind", "slope", "log_likelihood", "growth")
        whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return mixture.Mixture(**whole, shares=np.concatenate([part.shares for part in parts]))

    def _log_likelihoods(self, rows: Rows, distance: FloatArray, shares: FloatArray) -> FloatArray:
        """Return how likely each of some distances of rows is, shape (n,), as `mixed` has it."""
        sigma = np.sqrt(rows.variance)
        return np.concatenate(
            [
                mixture.log_likelihood(distance[part], sigma[part], group, its)
                for part, group, its in self._kinds(rows, shares)
            ]
        )

    def _kinds(self, rows: Rows, shares: FloatArray) -> tuple[tuple[slice, IntArray, FloatArray], ...]:
        """Return which rows are of faces and which of borders, in which group each is, and the shares of these."""
        faces, count = len(self.drive) * outline.FACES, int((rows.face < outline.FACES).sum())
        of_faces = slice(count), rows.frame[:count] * outline.FACES + rows.face[:count], shares[: faces + 1]
        of_borders = slice(count, None), rows.face[count:] - outline.FACES, shares[faces + 1 :]
        return (of_faces, of_borders) if self.bordered else (of_faces,)

    def weigh(self, rows: Rows, softening_m: float, shares: FloatArray) -> Fitness:
        """Return information and gradient, shape (5 + own,), where some distances were taken.

        The gradient takes the noise and the angles of incidence as they are there: were they free to change, a side
        would turn away from the sensor until its points' distances, which are shorter than their ranges, fit.

        Parameters
        ----------
        rows : Rows
        softening_m : float
            Added to the noise.
        shares : ndarray
            See `mixture.Mixture`.
        """
        sigma = np.sqrt(rows.variance + softening_m**2)
        mixed = self.mixed(rows, rows.distance, sigma, shares)
        weight = rows.share * mixed.surface / (sigma * mixed.growth) ** 2
        jacobian = self._by_all(rows)
        pull = mixed.slope * rows.share
        now = jacobian.copy()
        now[:, _CLOCK] = rows.by_time
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
        """Return what the gradient varies by, shape (p, p), because a matcher's errors last from frame to frame.

        What points on one side of a frame have in common decays with the way; what they have within the frame is in
        their weights.
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
        """Return by how much likelier the ranges are than before, with noise and angles of incidence held as they were.

        Of the points for which the messages tell the vehicle's place both times, and that stay on their side: where one
        changes sides, the likelihood jumps, which no derivative tells. That is what `weigh` tells.

        Parameters
        ----------
        rows, before : Rows
        here : ndarray, shape (n,)
            The `Fitness.log_likelihoods` of the rows before.
        shares : ndarray
            By which they were weighed.
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
        """Return the distances at some parameters, of the points chosen, or of those on the wall there."""
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
        if self.bordered and len(rows.frame):  # where nothing is seen of the outline, borders may be anything's
            rows = rows.joined(self._border_rows(x, poses))
        # A message's error is one for all of a frame: so many have together what one of them would have.
        each_frame = self.heading_variance + (poses if chosen is None else chosen).unsure / self.frame_s
        by_heading = (each_frame * np.bincount(rows.frame, rows.share, len(each_frame)))[rows.frame]
        return replace(rows, variance=rows.variance + by_heading * rows.jacobian[:, _HEADING] ** 2)

    def choose(self, x: FloatArray) -> Chosen:
        """Return which points meet the outline where it is upright, at some parameters, and how much each weighs.

        Points on one side in one frame share a part of their noise, and those in one window of a matcher all of it, so
        that many weigh no more than a few (Kish's design effect, 1 + (n - 1) rho). Those whose rays pass by are of the
        side that most are of.
        """
        poses = self._poses(x)
        met = self._wall(x, poses)
        return Chosen(met.points, self._shares(met), poses.unsure)

    def wall(self, x: FloatArray) -> Met:
        """Return what meets the outline where it is upright, while the messages tell the vehicle's place."""
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
        """Return what part of its variance each point's noise has in common with the others of its group, on average.

        Two windows that overlap share as much of their noise as of their pixels.
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
        """Append the derivatives by the knots: a bias of the messages moves the vehicle on the map."""
        hat = self.hat[rows.frame]
        return np.hstack([rows.jacobian, rows.jacobian[:, 1:2] * hat, rows.jacobian[:, 2:3] * hat])

    def _poses(self, x: FloatArray) -> Poses:
        at = self.drive.stamps_s + x[_CLOCK] + x[SWEEP] * self.drive.frames_late_s
        return poses_at(at, self.drive.vehicle, x[_HEADING], x[_LEVER], x[_BEGIN])

    def _into_vehicle(
        self, x: FloatArray, poses: Poses, frame: IntArray, arm: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Map points, given from ``centre`` in level axes, into the vehicle frame.

        Returns
        -------
        xy : ndarray, shape (n, 2)
        origin : ndarray, shape (n, 2)
            The sensor.
        yaw : ndarray, shape (n,)
            Of the body.
        """
        count = len(self.knots_s)
        bias = np.column_stack([self.hat @ x[_KNOTS : _KNOTS + count], self.hat @ x[_KNOTS + count :]])
        yaw = poses.yaw
        reference = np.tile(np.asarray(self.drive.vehicle.reference), (len(yaw), 1))
        swing = rotate_xy(yaw, reference) - rotate_xy(poses.heading, reference)
        shift = x[1:3] + bias - poses.xy + swing
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
        # Of what optics do along the line of sight, noise has its share: they scale what was measured.
        sight, ahead_m = self.sight[points], drive.points[points, 0]
        longer = np.column_stack([sight[:, 0] * ahead_m, dot_xy(sight, drive.points[points, :2])])
        rows.jacobian[:, BY_OPTICS] += ((1.0 - met.hits.reach) * towards)[:, None] * longer
        rows.jacobian[:, BIAS] = -drive.sigma_along_m[points] * towards
        # What is seen within half a window of a border may be the border's: beside the outline all of it, and on a side
        # that is narrower than that, for it is grazed.
        window_m = self._window_m(np.hypot(*drive.points[points, :2].T))
        aside_m = BORDER_SIGMA * window_m * (2.0 * met.hits.within < window_m)
        rows = replace(rows, variance=rows.variance + (1.0 - met.hits.cos**2) * aside_m**2)
        if drive.window_rad == 0.0:
            return rows
        mirrored = gloss.mirrored(met.hits.cos * np.cos(drive.above_rad[points]))
        rows.jacobian[:, _GLOSS] = mirrored * rows.jacobian[:, [BIAS]]
        return replace(rows, distance=rows.distance + rows.jacobian[:, _GLOSS] @ x[_GLOSS])

    def _window_m(self, range_m: FloatArray) -> FloatArray:
        """Return how wide a matcher's window is at ranges on the ground plan, shape (n,)."""
        window_m: FloatArray = self.drive.window_rad * np.hypot(range_m, self.drive.height_m)
        return window_m

    def _border_rows(self, x: FloatArray, poses: Poses) -> Rows:
        """Return by how much the outermost lines of sight miss the outline, beyond what its borders grow by.

        Where something hides a border, what is seen ends behind it, as a point behind the surface does.
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
        # Where the line of sight meets the side: a point that noise put elsewhere would move as it does there.
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
            late_s=late_s,
            face=hits.face,
            frame=frame,
            share=share,
            point=met.points,
        )

    def _centre_rows(self, x: FloatArray, poses: Poses) -> Rows:
        """Return how far a detector's centres are from the vehicle's, along and across it.

        Of their errors a part lasts while the vehicle is seen from one side, so that many weigh no more than a few
        (Kish's design effect, as in `choose`); which part, the boxes tell.
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
        """Return the derivatives of normal . xy by yaw, x, y, sweep, clock offset, heading error and lever, begin."""
        jacobian = np.zeros((len(xy), _KNOTS))
        normal_world = rotate_xy(yaw, normal)
        jacobian[:, 0] = dot_xy(normal_world, perpendicular(rotate_xy(x[0], arm)))
        jacobian[:, _NORMAL] = normal_world
        jacobian[:, _CLOCK] = by_time(poses.rates, frame, xy, normal, normal_world)
        jacobian[:, SWEEP] = late_s * jacobian[:, _CLOCK]
        about = -dot_xy(normal, perpendicular(xy - np.asarray(self.drive.vehicle.reference)))
        jacobian[:, _HEADING] = about
        jacobian[:, _LEVER] = about * poses.by_lever[frame]
        jacobian[:, _BEGIN] = about * poses.by_begin[frame]
        return jacobian


def _scale(x: FloatArray) -> FloatArray:
    """Return what focal length and baseline make of points ahead of a stereo camera, and to its side, shape (2,).

    Depth is their product over the disparity; across the axis the focal length cancels out. Of a camera that looks down
    it makes less on the ground plan, by the cosine's square, as the ground that is found tilts with it.
    """
    scale: FloatArray = 1.0 + x[BASELINE] + x[FOCAL] * AHEAD
    return scale


def _by_optics(x: FloatArray, normal_world: FloatArray, arm: FloatArray) -> FloatArray:
    """Return by how much focal length and baseline move points along their normals, shape (n, 2)."""
    normal, told = rotate_xy(-x[0], normal_world), arm / _scale(x)
    return np.column_stack([dot_xy(normal, told * AHEAD), dot_xy(normal, told)])


def _heading_variance(drive: Evidence, frame_s: float, otherwise_rad: float) -> float:
    """Return the variance that each frame has through the noise of the messages' headings, rad^2.

    One message's error is common to all frames until the next. For these to tell no more than it does, each has as many
    times its variance. Smoothing changes nothing in that: it makes errors smaller, and common to more frames.
    """
    message_s = float(np.median(np.diff(drive.vehicle.stamps_s)))
    return heading_noise(drive.vehicle, otherwise_rad) ** 2 * max(1.0, message_s / frame_s)
