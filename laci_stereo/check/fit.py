"""Planar error of a calibration, with covariance, from the offsets between paint and a map's lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.check.align import SHIFT_M, TURN_RAD, planar_rows
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import STEP_M
from laci_stereo.check.sections import Sections
from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray

WORN_M = 0.01
"""Standard deviation of a section's offset from worn paint: its edges are ragged by about this much on average over a
section."""

LENS_PX = 0.2
"""Residual error of a lens calibration, constant along a line: typical reprojection errors are 0.1 to 0.3 pixels."""

CROSSFALL_M = 0.015
"""Standard deviation of the road's height about its plane. Roads fall by up to 2.5 % to both sides (RASt 06), less
within crossings, so 1.4 % in root mean square. On a road 7 m wide this is 5.1 cm from the crown to the border; the
profile is a triangle, whose standard deviation is that height times the square root of a twelfth."""

CURVATURE_PER_M = 1e-4
"""Standard deviation of the road's vertical curvature: crests and sags of 10 km radius."""

CORRELATED_M = 20.0
"""Correlation length along a line: maps have a point every 10 to 20 m, and the wavelengths of roads are 5 to 25 m."""


@dataclass(frozen=True)
class Offsets(Columns):
    """Offsets of paint from sections of lines.

    Attributes
    ----------
    sections : Sections
    left_m : ndarray, shape (n,)
        Offset of the paint to the left of the map's line.
    cell_m : ndarray, shape (n,)
        Width that a pixel covers across the line.
    loose_m : ndarray, shape (n,)
        Standard deviation of the offset between the mapped and the visible feature, constant along a line.
    """

    sections: Sections
    left_m: FloatArray
    cell_m: FloatArray
    loose_m: FloatArray

    def __len__(self) -> int:
        return len(self.left_m)


@dataclass(frozen=True)
class PlanarError:
    """Planar error of a calibration: shift and turn of the ground about a point.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        World, metres.
    value : ndarray, shape (3,)
        Shift east and north, metres, and turn counter-clockwise, rad: position by the calibration minus true position.
    covariance : ndarray, shape (3, 3)
        Covariance of the measured value, including the map's own error.
    expected : ndarray, shape (3, 3)
        Covariance of the value if the calibration is as accurate as its covariance claims.
    """

    centre: FloatArray
    value: FloatArray
    covariance: FloatArray
    expected: FloatArray

    @property
    def chi_square(self) -> float:
        """Squared Mahalanobis distance of ``value`` under ``expected``; chi-square with three degrees of freedom."""
        return float(self.value @ np.linalg.solve(self.expected, self.value))


def fit_planar(offsets: Offsets, placed: Placed, map_sigma_m: float) -> PlanarError:
    """Fit shift and turn to offsets by generalised least squares.

    Height and tilt have the covariance that the calibration claims; shift and turn are free.

    Parameters
    ----------
    offsets : Offsets
        At least one offset.
    placed : Placed
    map_sigma_m : float
        Standard deviation of a line's position in the map; half of the variance is common to the map, half is each
        line's own.
    """
    sections = offsets.sections
    centre = sections.xy.mean(axis=0)
    rows = planar_rows(sections, centre)
    claimed = np.einsum("ij,ijk->ik", sections.left, placed.jacobian(sections.xy))
    unclaimed = covariance_of(offsets, placed, map_sigma_m)
    free = placed.covariance.copy()
    free[[2, 3, 4]], free[:, [2, 3, 4]] = 0.0, 0.0
    weights = np.linalg.inv(unclaimed + claimed @ free @ claimed.T)
    # Errors beyond the search range are not found, so it is the prior of a direction that no line determines.
    known = np.diag(1.0 / np.array([SHIFT_M, SHIFT_M, TURN_RAD]) ** 2)
    covariance = np.linalg.inv(rows.T @ weights @ rows + known)
    gain = covariance @ rows.T @ weights
    value = gain @ offsets.left_m
    expected = gain @ (unclaimed + claimed @ placed.covariance @ claimed.T) @ gain.T + covariance @ known @ covariance
    return PlanarError(centre, value, covariance, expected)


def covariance_of(offsets: Offsets, placed: Placed, map_sigma_m: float) -> FloatArray:
    """Return the covariance, shape (n, n), of offsets for an exact calibration.

    Each line has its own map error and the road below it its own height error, both correlated over short distances;
    the map has a common shift; the road is curved vertically; the remaining errors are independent for each section.
    """
    sections = offsets.sections
    raised = np.einsum("ij,ij->i", sections.left, placed.lengthening(sections.xy))
    apart = np.abs(sections.along_m[:, None] - sections.along_m)
    alike = (sections.line[:, None] == sections.line) * np.exp(-apart / CORRELATED_M)
    covariance = alike * (map_sigma_m**2 / 2 + CROSSFALL_M**2 * np.outer(raised, raised))
    for common in (LENS_PX * offsets.cell_m, offsets.loose_m):
        covariance += (sections.line[:, None] == sections.line) * np.outer(common, common)
    covariance += map_sigma_m**2 / 2 * sections.left @ sections.left.T
    for bent in _bends(sections.xy - placed.centre_world[:2]):
        covariance += CURVATURE_PER_M**2 * np.outer(raised * bent, raised * bent)
    own = WORN_M**2 + STEP_M**2 / 12 + offsets.cell_m**2 / 12
    return np.asarray(covariance + np.diag(own))


def _bends(xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the heights of surfaces of unit curvature that are tangent to the ground at the track's centre."""
    x, y = xy.T
    return x**2 / 2, y**2 / 2, x * y / np.sqrt(2.0)
