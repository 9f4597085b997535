"""By how much a calibration is off in the plane, from where paint lies beside the map's lines; with its covariance."""

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
"""Paint's edges are ragged by about this much, and a section averages them."""

LENS_PX = 0.2
"""What a lens's calibration leaves over, the same along a line: typical reprojection errors are 0.1 to 0.3 pixels."""

CROSSFALL_M = 0.015
"""The road's height off its plane: roads fall by up to 2.5 % to both sides (RASt 06), less within crossings, so 1.4 %
in root mean square. On 7 m these are 5.1 cm from the middle to the border, a triangle, and its standard deviation is
the square root of a twelfth of that."""

CURVATURE_PER_M = 1e-4
"""One sigma of the road's vertical curvature: crests and sags of 10 km radius."""

CORRELATED_M = 20.0
"""Along a line: maps have a point every 10 to 20 m, and roads wave in 5 to 25 m."""


@dataclass(frozen=True)
class Offsets(Columns):
    """Where paint was found beside sections of lines.

    Attributes
    ----------
    sections : Sections
    left_m : ndarray, shape (n,)
        Of the paint, to the left of the map's line.
    cell_m : ndarray, shape (n,)
        What a pixel covers across.
    loose_m : ndarray, shape (n,)
        Standard deviation of what a line means against what is seen of it, the same along it.
    """

    sections: Sections
    left_m: FloatArray
    cell_m: FloatArray
    loose_m: FloatArray

    def __len__(self) -> int:
        return len(self.left_m)


@dataclass(frozen=True)
class PlanarError:
    """By how much a calibration puts things off: shift and turn of the ground about a point.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        World.
    value : ndarray, shape (3,)
        East and north, metres, and counter-clockwise, rad: what the calibration puts minus where it is.
    covariance : ndarray, shape (3, 3)
        Of the value as measured, the map's own error included.
    expected : ndarray, shape (3, 3)
        Of the value where the calibration is as good as it claims.
    """

    centre: FloatArray
    value: FloatArray
    covariance: FloatArray
    expected: FloatArray

    @property
    def chi_square(self) -> float:
        """Of the value against what is expected, with three degrees of freedom."""
        return float(self.value @ np.linalg.solve(self.expected, self.value))


def fit_planar(offsets: Offsets, placed: Placed, map_sigma_m: float) -> PlanarError:
    """Fit shift and turn to offsets by generalised least squares.

    Height and tilt are as uncertain as the calibration claims them to be; shift and turn are free.

    Parameters
    ----------
    offsets : Offsets
        At least one.
    placed : Placed
    map_sigma_m : float
        Of a line's place in the map; half of the variance is the whole map's, half each line's own.
    """
    sections = offsets.sections
    centre = sections.xy.mean(axis=0)
    rows = planar_rows(sections, centre)
    claimed = np.einsum("ij,ijk->ik", sections.left, placed.jacobian(sections.xy))
    others = covariance_of(offsets, placed, map_sigma_m)
    free = placed.covariance.copy()
    free[[2, 3, 4]], free[:, [2, 3, 4]] = 0.0, 0.0
    weights = np.linalg.inv(others + claimed @ free @ claimed.T)
    # What is beyond the search is not found, so a direction that nothing tells is as open as that.
    known = np.diag(1.0 / np.array([SHIFT_M, SHIFT_M, TURN_RAD]) ** 2)
    covariance = np.linalg.inv(rows.T @ weights @ rows + known)
    gain = covariance @ rows.T @ weights
    value = gain @ offsets.left_m
    expected = gain @ (others + claimed @ placed.covariance @ claimed.T) @ gain.T + covariance @ known @ covariance
    return PlanarError(centre, value, covariance, expected)


def covariance_of(offsets: Offsets, placed: Placed, map_sigma_m: float) -> FloatArray:
    """Return the covariance, shape (n, n), of offsets where the calibration is exact.

    Each line is off on its own, and the road below it is, both the same for places near to each other; the map is off
    as a whole; the road bends up or down; the rest is each section's own.
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
    """Return the heights of surfaces of unit curvature that touch the ground at the track's centre."""
    x, y = xy.T
    return x**2 / 2, y**2 / 2, x * y / np.sqrt(2.0)
