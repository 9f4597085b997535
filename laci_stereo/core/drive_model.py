"""The model of one drive: how far its points are from the outline, and what every parameter does to that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core import mixture, outline
from laci_stereo.core.evidence import Evidence
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, rotate_xy
from laci_stereo.core.settings import JointSettings

FIRST_OWN = 4
"""Yaw, x, y and the range bias are the sensor's; what follows is each drive's own: clock offset, heading error, heading
lever, the shape, and the knots of the GNSS bias."""

_CLOCK, _HEADING, _LEVER, _SHAPE = 4, 5, 6, 7
_KNOTS = _SHAPE + len(outline.SHAPE)
_STEP_S = 0.02
_SLOWEST_MPS = 1.0


CORRECTED = ("clock", "heading", "ahead", "left", "length", "width")
"""What of the messages is corrected: clock offset [s], heading [rad], where on the vehicle the position is [m], size."""


@dataclass(frozen=True)
class Correction:
    """Something that the messages tell and the points contradict.

    Attributes
    ----------
    what : str
        One of `CORRECTED`.
    value, sigma : float
        The correction, and the standard deviation that was to be expected.
    """

    what: str
    value: float
    sigma: float


def _corrected(own: int) -> FloatArray:
    """Return what each of `CORRECTED` is of a drive's own parameters, shape (6, own)."""
    by = np.zeros((len(CORRECTED), own))
    shape = _SHAPE - FIRST_OWN
    by[0, _CLOCK - FIRST_OWN] = by[1, _HEADING - FIRST_OWN] = 1.0
    by[2, shape : shape + 2] = 0.5, -0.5
    by[3, shape + 3] = 1.0
    by[4, shape : shape + 2] = 1.0
    by[5, shape + 2] = 2.0
    return by


@dataclass(frozen=True)
class Fitness:
    """How well a drive fits, at one point in the space of parameters.

    Attributes
    ----------
    information : ndarray, shape (p, p)
    gradient : ndarray, shape (p,)
        Of the negative log-likelihood.
    block_scores : ndarray, shape (b, p)
        The gradient, by blocks of time.
    log_likelihood : float
    shares : ndarray
        See `mixture.Mixture`.
    weight, squares : float
        Of the points of the surface, and the sum of their squared distances.
    explained, rows : float
        Points that the outline explains, and all.
    frames : int
        With points of the surface.
    """

    information: FloatArray
    gradient: FloatArray
    block_scores: FloatArray
    log_likelihood: float
    shares: FloatArray
    weight: float
    squares: float
    explained: float
    rows: float
    frames: int


@dataclass(frozen=True)
class _Poses:
    """The vehicle in the frames: position and yaw, their rates, the path's curvature, and where they are known."""

    xy: FloatArray
    yaw: FloatArray
    velocity: FloatArray
    yaw_rate: FloatArray
    curvature: FloatArray
    known: BoolArray


@dataclass(frozen=True)
class Rows:
    """Distances from the outline, with their derivatives by the first parameters, up to the knots.

    Attributes
    ----------
    distance, variance : ndarray, shape (n,)
    jacobian : ndarray, shape (n, 14)
    face, frame : ndarray of int, shape (n,)
    """

    distance: FloatArray
    variance: FloatArray
    jacobian: FloatArray
    face: IntArray
    frame: IntArray


class DriveModel:
    """One drive, with what does not change while the parameters do."""

    def __init__(self, drive: Evidence, centre: FloatArray, settings: JointSettings) -> None:
        self.drive = drive
        self.centre = centre
        self.settings = settings
        self.size = (drive.vehicle.length_m, drive.vehicle.width_m)
        heavy = self.size[1] >= outline.HEAVY_WIDTH_M
        self.highest_m = outline.HEAVY_HIGHEST_M if heavy else outline.HIGHEST_M
        first, last = drive.stamps_s[[0, -1]] if len(drive) else (0.0, 0.0)
        knots = max(2, int(np.ceil((last - first) / (settings.bias_time_s / 4))) + 1)
        self.knots_s = np.linspace(first, max(last, first + 1e-3), knots)
        self.hat = np.maximum(
            0.0, 1.0 - np.abs(drive.stamps_s[:, None] - self.knots_s) / (self.knots_s[1] - self.knots_s[0])
        )
        self.own = _KNOTS - FIRST_OWN + 2 * knots
        self.block = ((drive.stamps_s - first) // settings.block_s).astype(int)
        range_m = np.linalg.norm(drive.points[:, :2], axis=1)
        self.sight = drive.points[:, :2] / np.maximum(range_m, 1e-9)[:, None]

    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Return precision, shape (own, own), and mean of the drive's own parameters."""
        settings, vehicle = self.settings, self.drive.vehicle
        covariance = np.zeros((self.own, self.own))
        covariance[0, 0] = settings.clock_sigma_s**2
        covariance[1, 1] = np.radians(settings.heading_sigma_deg) ** 2
        covariance[2, 2] = settings.heading_lever_sigma_m**2
        shape = slice(_SHAPE - FIRST_OWN, _KNOTS - FIRST_OWN)
        # An error of the length moves the side that the position does not refer to.
        fixed = np.clip(0.5 + vehicle.reference[0] / vehicle.length_m, 0.0, 1.0)
        by_length, by_lever = np.zeros(len(outline.SHAPE)), np.zeros(len(outline.SHAPE))
        by_length[:3] = 1.0 - fixed, fixed, 0.0
        by_lever[:2] = 1.0, -1.0
        by_width, by_lever_y = np.eye(len(outline.SHAPE))[[2, 3]]
        covariance[shape, shape] = (
            np.diag(outline.SHAPE_SIGMA**2)
            + settings.size_sigma_m**2 * (np.outer(by_length, by_length) + np.outer(by_width, by_width) / 4)
            + settings.lever_sigma_m**2 * (np.outer(by_lever, by_lever) + np.outer(by_lever_y, by_lever_y))
        )
        sigma = vehicle.position_sigma_m if np.isfinite(vehicle.position_sigma_m) else settings.position_sigma_m
        apart = np.abs(self.knots_s[:, None] - self.knots_s) / settings.bias_time_s
        drift = sigma**2 * np.exp(-apart)
        count = len(self.knots_s)
        knots = _KNOTS - FIRST_OWN
        covariance[knots : knots + count, knots : knots + count] = drift
        covariance[knots + count :, knots + count :] = drift
        mean = np.zeros(self.own)
        mean[shape] = outline.SHAPE_MEAN
        precision: FloatArray = np.linalg.inv(covariance)
        return precision, mean

    def corrections(self, own: FloatArray) -> tuple[Correction, ...]:
        """Return by how much the messages had to be corrected, against what was to be expected."""
        precision, mean = self.prior()
        covariance = np.linalg.inv(precision)
        return tuple(
            Correction(what, float(by @ (own - mean)), float(np.sqrt(by @ covariance @ by)))
            for what, by in zip(CORRECTED, _corrected(self.own), strict=True)
        )

    def shares(self) -> FloatArray:
        """Return the mixture's shares to begin with."""
        return mixture.first_shares(len(self.drive) * outline.FACES)

    def weigh(self, x: FloatArray, softening_m: float, shares: FloatArray) -> Fitness:
        """Return information and gradient at some parameters, shape (4 + own,).

        Points on one side in one frame share a part of their noise, so that many weigh no more than a few
        (Kish's design effect, 1 + (n - 1) rho).
        """
        rows = self.rows(x)
        sigma = np.sqrt(rows.variance + softening_m**2)
        group = rows.frame * outline.FACES + rows.face
        mixed = mixture.weigh(rows.distance, sigma, group, shares)
        together = np.bincount(group, mixed.surface, len(shares))[group]
        share = 1.0 / (1.0 + np.maximum(together - 1.0, 0.0) * self.settings.shared_noise_share)
        weight = share * mixed.surface / sigma**2
        jacobian = self._by_all(rows)
        scores = jacobian * (mixed.slope * share)[:, None]
        blocks = np.zeros((int(self.block.max(initial=0)) + 1, jacobian.shape[1]))
        np.add.at(blocks, self.block[rows.frame], scores)
        held = np.bincount(rows.frame, mixed.surface, len(self.drive)) > 1.0
        return Fitness(
            information=(jacobian * weight[:, None]).T @ jacobian,
            gradient=blocks.sum(axis=0),
            block_scores=blocks,
            log_likelihood=float((share * mixed.log_likelihood).sum()),
            shares=mixed.shares,
            weight=float(mixed.surface.sum()),
            squares=float((mixed.surface * rows.distance**2).sum()),
            explained=float((mixed.surface + mixed.behind).sum()),
            rows=float(len(rows.distance)),
            frames=int(held.sum()),
        )

    def rows(self, x: FloatArray) -> Rows:
        """Return the distances at some parameters."""
        poses = self._poses(x)
        return self._outline_rows(x, poses) if len(self.drive.points) else self._centre_rows(x, poses)

    def _by_all(self, rows: Rows) -> FloatArray:
        """Append the derivatives by the knots: a bias of the messages moves the vehicle on the map."""
        hat = self.hat[rows.frame]
        return np.hstack([rows.jacobian, rows.jacobian[:, 1:2] * hat, rows.jacobian[:, 2:3] * hat])

    def _poses(self, x: FloatArray) -> _Poses:
        at = self.drive.stamps_s + x[_CLOCK]
        xy, yaw, known = self.drive.vehicle.at(at)
        before, yaw_before, known_before = self.drive.vehicle.at(at - _STEP_S)
        after, yaw_after, known_after = self.drive.vehicle.at(at + _STEP_S)
        both = known_before & known_after
        velocity = np.where(both[:, None], after - before, 0.0) / (2 * _STEP_S)
        yaw_rate = np.where(both, yaw_after - yaw_before, 0.0) / (2 * _STEP_S)
        speed = np.linalg.norm(velocity, axis=1)
        return _Poses(xy, yaw, velocity, yaw_rate, yaw_rate / np.maximum(speed, _SLOWEST_MPS), known)

    def _into_vehicle(
        self, x: FloatArray, poses: _Poses, frame: IntArray, arm: FloatArray
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
        turned = x[_HEADING] + x[_LEVER] * poses.curvature
        yaw = poses.yaw + turned
        reference = np.tile(np.asarray(self.drive.vehicle.reference), (len(yaw), 1))
        swing = rotate_xy(yaw, reference) - rotate_xy(poses.yaw, reference)
        shift = x[1:3] + bias - poses.xy + swing
        xy = rotate_xy(-yaw[frame], rotate_xy(x[0], arm) + shift[frame])
        origin = rotate_xy(-yaw, rotate_xy(x[0], -self.centre) + shift)
        return xy, origin[frame], yaw[frame]

    def _outline_rows(self, x: FloatArray, poses: _Poses) -> Rows:
        drive = self.drive
        chosen = np.flatnonzero(poses.known[drive.frame])
        frame = drive.frame[chosen]
        sight, along = self.sight[chosen], drive.sigma_along_m[chosen]
        arm = drive.points[chosen, :2] - x[3] * along[:, None] * sight - self.centre
        xy, origin, yaw = self._into_vehicle(x, poses, frame, arm)
        hits = outline.meet(xy, origin, along, drive.sigma_across_m[chosen], self.size, x[_SHAPE:_KNOTS])
        wall = outline.on_the_wall(
            drive.height_m,
            drive.points[chosen, 2],
            hits.reach,
            drive.sigma_z_m[chosen],
            outline.LOWEST_M,
            self.highest_m,
        )
        jacobian = self._jacobian(x, poses, frame, arm, xy, yaw, hits.normal)
        jacobian[:, 3] = -along * (rotate_xy(-yaw, rotate_xy(x[0], sight)) * hits.normal).sum(axis=1)
        jacobian[:, _SHAPE:] = hits.by_shape
        return Rows(hits.distance[wall], hits.variance[wall], jacobian[wall], hits.face[wall], frame[wall])

    def _centre_rows(self, x: FloatArray, poses: _Poses) -> Rows:
        """Return how far a detector's centres are from the vehicle's, along and across it."""
        frame = np.flatnonzero(poses.known)
        arm = self.drive.middles[frame] - self.centre
        xy, _, yaw = self._into_vehicle(x, poses, frame, arm)
        shape = x[_SHAPE:_KNOTS]
        middle = np.array([(shape[0] - shape[1]) / 2, shape[3]])
        parts = []
        for axis, moved in ((0, (0.5, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0)), (1, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))):
            normal = np.tile(np.eye(2)[axis], (len(frame), 1))
            jacobian = self._jacobian(x, poses, frame, arm, xy, yaw, normal)
            jacobian[:, _SHAPE:] = -np.array(moved)
            distance = xy[:, axis] - middle[axis]
            spread = 1.4826 * np.median(np.abs(distance - np.median(distance))) if len(distance) else 0.0
            variance = np.full(len(frame), max(spread, outline.OUTLINE_SIGMA_M) ** 2)
            parts.append(Rows(distance, variance, jacobian, np.full(len(frame), axis), frame))
        return Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in Rows.__dataclass_fields__))

    def _jacobian(
        self,
        x: FloatArray,
        poses: _Poses,
        frame: IntArray,
        arm: FloatArray,
        xy: FloatArray,
        yaw: FloatArray,
        normal: FloatArray,
    ) -> FloatArray:
        """Return the derivatives of normal . xy by yaw, x, y, clock offset, heading error and heading lever."""
        jacobian = np.zeros((len(xy), _KNOTS))
        normal_world = rotate_xy(yaw, normal)
        jacobian[:, 0] = (normal_world * _turned(rotate_xy(x[0], arm))).sum(axis=1)
        jacobian[:, 1:3] = normal_world
        moved = (normal_world * poses.velocity[frame]).sum(axis=1)
        jacobian[:, _CLOCK] = -moved - poses.yaw_rate[frame] * (normal * _turned(xy)).sum(axis=1)
        about = -(normal * _turned(xy - np.asarray(self.drive.vehicle.reference))).sum(axis=1)
        jacobian[:, _HEADING] = about
        jacobian[:, _LEVER] = about * poses.curvature[frame]
        return jacobian


def _turned(xy: FloatArray) -> FloatArray:
    """Return vectors, shape (n, 2), turned by a right angle to the left."""
    return np.column_stack([-xy[:, 1], xy[:, 0]])
