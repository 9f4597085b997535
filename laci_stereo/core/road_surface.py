"""The surface of a road along a way: a plane that is bent a little, falls to both sides of a crown, and is uneven.

A lane is tilted against its carriageway by up to 2.5 %, so that a plane through what is near a way is not the road's.
Here the crown is a part of the model: where both of its sides are seen, it is told from the plane; where only one is,
how far the road falls stays as open as it was. It runs along the way, or the way crosses it, as in a turn and around a
roundabout's island. Edges of the road are another part of it: what is behind one is no longer the road. Heights are
those above a plane that was found before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from laci_stereo.core.box_ground import BENT_PER_M
from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.ground_uneven import CLASS_B_M, REACH_M
from laci_stereo.core.road_edges import KINDS, ON_WAY_M, TOWARDS, behind_edges

FALL = 0.025 / np.sqrt(3.0)
"""How a road falls to either side of its crown, so that it drains: by anything up to 2.5 %, one standard deviation."""

OTHER = (0.3, 2.0 * FALL, 2.0 * FALL)
"""Height and slopes of a plane that is the land's beside a road, from the road's, standard deviations: it is a foot
higher or lower, and falls by twice as much."""

_FALLS = np.arange(0.0, 0.031, 0.0025)
_CROWNS_M = np.arange(-7.0, 7.1, 0.25)
"""Falls, and how far to the left of the way a crown along it is, within two lanes: all are as likely."""

_ACROSS_RAD = np.pi / 8 * np.arange(8)
_ACROSS = np.stack([np.cos(_ACROSS_RAD), np.sin(_ACROSS_RAD)])
_CROSSED = (0.15, 0.325, 0.5, 0.675, 0.85)
"""Crowns that the way crosses are straight: directions in which the road falls from one, and which shares of what is
seen are on one side of it. As often as not the crown is such a one; all of each kind are as likely."""

_CLASSES = np.array([-1.0, 0.0, 1.0])
"""Of unevenness, against ISO 8608's class B: with each it is twice as large; as much is one standard deviation."""

LASER_RAD = float(np.radians(0.2))
"""What is seen in the same elevation was measured by one laser of a scanner: few have layers closer to one another."""

_PATCHES = 100
"""So many means of cells tell as much as all cells: a road is as high where it is uneven over several metres."""


@dataclass(frozen=True)
class Cells(Columns):
    """What is seen in squares of the ground plan along a way.

    Attributes
    ----------
    xy : ndarray, shape (n, 2)
        Level frame, metres.
    z, variance : ndarray, shape (n,)
        Height, and its variance through noise that no other cell has.
    sigma_m : ndarray, shape (n,)
        Standard deviation of one point's height through its noise.
    left_m : ndarray, shape (n,)
        How far to the left of the way.
    piece : ndarray of int, shape (n,)
        Piece of the way, one number for each of its sides.
    sight : ndarray, shape (n, 2)
        Azimuth and elevation in which the sensor sees it, in windows of its matcher: what is in one has all noise in
        common. A scanner's windows are too narrow for two.
    layer : ndarray, shape (n,)
        Elevation in the sensor frame in which a scanner sees it, in `LASER_RAD`; NaN for a camera.
    """

    xy: FloatArray
    z: FloatArray
    variance: FloatArray
    sigma_m: FloatArray
    left_m: FloatArray
    piece: IntArray
    sight: FloatArray
    layer: FloatArray

    def __len__(self) -> int:
        return len(self.z)


@dataclass(frozen=True)
class _Given:
    """What is known if the road is as uneven as some class, with no fall.

    Attributes
    ----------
    likely : ndarray, shape (crowns, falls)
        How likely the class is, with each crown and fall.
    mean, covariance : ndarray, shape (6,) and (6, 6)
        Of the plane, and how the road is bent: roads that cross are in both directions.
    by_fall : ndarray, shape (6, crowns)
        By how much a fall of 1 lessens the mean.
    """

    likely: FloatArray
    mean: FloatArray
    covariance: FloatArray
    by_fall: FloatArray


class Surface:
    """The distribution of a road's surface, given cells on it.

    The plane, how the road is bent and how uneven it is are normal, a Gaussian process with explicit basis functions
    (Rasmussen and Williams 2006, section 2.7); the fall and the place of the crown, and the class of unevenness, are
    summed over by their evidence.

    Parameters
    ----------
    cells : Cells
    shared_noise_share : float
        Of each point's standard deviation, the part that errs for all points alike, and again for all of one laser.
    before : ndarray, shape (3,)
        Height at the origin, and slopes, of the ground near which the road is beforehand, by `OTHER`.
    edges : bool
        Some of the cells may be behind an edge of the road.
    """

    def __init__(self, cells: Cells, shared_noise_share: float, before: FloatArray, *, edges: bool = False) -> None:
        self.cells, self.before, self.edges = cells, before, edges
        self.middle = cells.xy.mean(axis=0)
        prior = np.square([*OTHER, BENT_PER_M, BENT_PER_M / 2, BENT_PER_M])
        self.crossed_m = np.quantile((cells.xy - self.middle) @ _ACROSS, _CROSSED, axis=0)
        away_m = np.abs(cells.left_m)
        on_way = cells.xy[away_m <= max(ON_WAY_M, float(away_m.min()))]
        self.way_m = ((on_way - self.middle) @ TOWARDS).max(axis=0)
        kinds, lasers = self._crowns(cells), _lasers(cells.layer)
        hidden = [kind.likely for kind in KINDS] if edges else []
        share = np.array([(1.0 - sum(hidden)) / 2, (1.0 - sum(hidden)) / 2, *hidden])
        of_each = np.array([kind.shape[1] for kind in kinds])
        log_prior = np.log(np.repeat(share / of_each, of_each))[:, None]
        crowns = np.column_stack(kinds)
        patches = _merged(np.column_stack([self._basis(cells.xy), crowns, lasers]), cells)
        widths = np.cumsum([6, crowns.shape[1], lasers.shape[1], 1, 1, 1, 2])
        basis, crowns, lasers, z, sigma_m, variance, xy, sight = np.split(patches, widths, axis=1)
        z = z - height_of(before, xy)[:, None]
        overlap = np.maximum(0.0, 1.0 - np.abs(sight[:, None] - sight)).prod(axis=2)
        noise = np.sqrt(variance @ variance.T) * overlap
        noise += shared_noise_share**2 * (sigma_m @ sigma_m.T) * (1.0 + lasers @ lasers.T) + (basis * prior) @ basis.T
        alike = np.exp(-np.linalg.norm(xy[:, None] - xy, axis=2) / REACH_M)
        found = []
        for uneven in _CLASSES:
            factor = cho_factor(noise + (2.0**uneven * CLASS_B_M) ** 2 * alike, lower=True)
            by_z, by_basis, by_crowns = np.split(cho_solve(factor, np.hstack([z, basis, crowns])), [1, 7], axis=1)
            squares = float(z[:, 0] @ by_z[:, 0]) - 2.0 * (crowns.T @ by_z) * _FALLS
            squares = squares + (crowns * by_crowns).sum(axis=0)[:, None] * _FALLS**2
            log_likely = log_prior - 0.5 * (squares + uneven**2) - np.log(np.diag(factor[0])).sum()
            covariance = np.diag(prior) - prior[:, None] * (basis.T @ by_basis) * prior
            by_fall = prior[:, None] * (basis.T @ by_crowns)
            found.append((log_likely, prior * (basis.T @ by_z)[:, 0], covariance, by_fall))
        most = max(float(log_likely.max()) for log_likely, *_ in found)
        total = sum(float(np.exp(log_likely - most).sum()) for log_likely, *_ in found)
        self.given = [_Given(np.exp(log_likely - most) / total, *known) for log_likely, *known in found]

    def heights(self, cells: Cells) -> tuple[FloatArray, FloatArray]:
        """Return the height of the even surface at some cells, and its variance, each of shape (n,)."""
        basis, crowns = self._basis(cells.xy), np.column_stack(self._crowns(cells))
        first, second = np.zeros(len(cells)), np.zeros(len(cells))
        for each in self.given:
            flat, falls, likely = basis @ each.mean, crowns - basis @ each.by_fall, each.likely.sum()
            once, twice = falls @ (each.likely @ _FALLS), falls**2 @ (each.likely @ _FALLS**2)
            first += likely * flat + once
            second += likely * (((basis @ each.covariance) * basis).sum(axis=1) + flat**2) + 2.0 * flat * once + twice
        return height_of(self.before, cells.xy) + first, np.maximum(second - first**2, 0.0)

    def plane(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the plane that the road is about: its height at the middle, and its slopes along x and y.

        The slopes are those between both sides of the crown. A bent road has them in its middle, and others where it
        goes on, by as much as it is bent over what is seen of it.

        Returns
        -------
        value : ndarray, shape (3,)
        covariance : ndarray, shape (3, 3)
        by_crown : ndarray, shape (3, 3)
            The part of it that is due to the crown, of which nobody knows who does not see both of its sides.
        """
        to_plane = np.eye(3, 6)
        to_plane[0] = self._basis(self.cells.xy).mean(axis=0)
        along, crossed, *edges = (kind.mean(axis=0) for kind in self._crowns(self.cells))
        crowns = np.concatenate([along, crossed, *map(np.zeros_like, edges)])  # what is behind an edge is not the road
        of_crowns = np.outer((1.0, 0.0, 0.0), crowns)
        first, second, within, bent = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
        for each in self.given:
            values = (to_plane @ each.mean)[:, None, None] + (of_crowns - to_plane @ each.by_fall)[:, :, None] * _FALLS
            first += np.tensordot(values, each.likely, 2)
            second += _squares(values, each.likely)
            within += each.likely.sum() * to_plane @ each.covariance @ to_plane.T
            bends = each.mean[3:, None, None] - each.by_fall[3:, :, None] * _FALLS
            bent += _squares(bends, each.likely) + each.likely.sum() * each.covariance[3:, 3:]
        by_crown = second - np.outer(first, first)
        (xx, xy), (_, yy) = np.cov(self.cells.xy.T, bias=True)
        # Over (dx, dy) the slopes change by (bent_xx dx + bent_xy dy, bent_xy dx + bent_yy dy).
        within[1, 1] += bent[0, 0] * xx + 2.0 * bent[0, 1] * xy + bent[1, 1] * yy
        within[2, 2] += bent[1, 1] * xx + 2.0 * bent[1, 2] * xy + bent[2, 2] * yy
        both = bent[0, 1] * xx + (bent[0, 2] + bent[1, 1]) * xy + bent[1, 2] * yy
        within[1, 2] += both
        within[2, 1] += both
        offset = np.append(height_of(self.before, self.middle), self.before[1:])
        return offset + first, within + by_crown, by_crown

    def _crowns(self, cells: Cells) -> list[FloatArray]:
        """Return by how much places are higher for each crown and edge if the road falls by 1, by kind, (n, crowns)."""
        off = cells.xy - self.middle
        crossed = (off @ _ACROSS)[:, None] - self.crossed_m
        crowns = [-np.abs(cells.left_m[:, None] - _CROWNS_M), -np.abs(crossed.reshape(len(cells), -1))]
        return crowns + (behind_edges(cells.left_m, off @ TOWARDS - self.way_m) if self.edges else [])

    def _basis(self, xy: FloatArray) -> FloatArray:
        """Return what a plane and its bends are made of, shape (n, 6)."""
        x, y = (xy - self.middle).T
        return np.column_stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2])


def height_of(plane: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the height of a plane, given as that at the origin and its slopes, at places of shape (..., 2)."""
    height: FloatArray = plane[0] + xy @ plane[1:]
    return height


def _squares(values: FloatArray, likely: FloatArray) -> FloatArray:
    """Return the mean of the products of values, shape (k, crowns, falls), by how likely they are."""
    squares: FloatArray = np.einsum("icf,jcf,cf->ij", values, values, likely)
    return squares


def _lasers(layer: FloatArray) -> FloatArray:
    """Return to which lasers cells belong, shape (n, k): between two elevations to both, half of the variance each."""
    if np.isnan(layer).any():
        return np.zeros((len(layer), 0))
    low = np.floor(layer)
    number, upper, row = (low - low.min()).astype(np.int64), layer - low, np.arange(len(layer))
    belongs = np.zeros((len(layer), number.max() + 2))
    belongs[row, number], belongs[row, number + 1] = np.sqrt(1.0 - upper), np.sqrt(upper)
    return belongs


def _merged(columns: FloatArray, cells: Cells) -> FloatArray:
    """Return means over patches: of some columns, of height and one point's noise, their variance, and the place."""
    side_m = 1.0
    while True:
        square = np.floor(cells.xy / side_m).astype(np.int64)
        square -= square.min(axis=0)
        patch = np.unique(square @ [square[:, 1].max() + 1, 1], return_inverse=True)[1].reshape(-1)
        if patch.max() < _PATCHES:
            break
        side_m *= 1.2
    window = np.floor(cells.sight).astype(np.int64)
    _, alike, count = np.unique(np.column_stack([patch, window]), axis=0, return_inverse=True, return_counts=True)
    weight = 1.0 / cells.variance
    total = np.bincount(patch, weight)
    told = np.bincount(patch, weight / count[alike.reshape(-1)])
    rows = np.column_stack([columns, cells.z, cells.sigma_m, cells.variance, cells.xy, cells.sight])
    means = np.stack([np.bincount(patch, weight * row) / total for row in rows.T], axis=1)
    means[:, -5] = 1.0 / told
    return means
