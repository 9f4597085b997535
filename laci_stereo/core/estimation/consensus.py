"""Several estimates of the same three numbers, and how far they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from laci_stereo.core.frames import FloatArray


@dataclass(frozen=True)
class Estimates:
    """Independent estimates of three numbers.

    Attributes
    ----------
    values : ndarray, shape (n, 3)
    covariances : ndarray, shape (n, 3, 3)
    """

    values: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.values)

    def mean(self, chosen: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the weighted mean of some estimates, shape (3,), and its covariance, shape (3, 3)."""
        return weighted_mean(self.values[list(chosen)], self.covariances[list(chosen)])

    def chi_square(self, chosen: Sequence[int]) -> float:
        """Return the sum of the squared Mahalanobis distances of some estimates from their mean."""
        off = self.values[list(chosen)] - self.mean(chosen)[0]
        return float(np.einsum("ni,nij,nj->", off, np.linalg.inv(self.covariances[list(chosen)]), off))

    def chance(self, chosen: Sequence[int]) -> float:
        """Return the probability that some estimates with correct covariances differ by as much."""
        return float(chdtrc(_freedom(chosen), self.chi_square(chosen))) if len(chosen) > 1 else 1.0

    def excess(self, chosen: Sequence[int]) -> float:
        """Return by how much the variance among some estimates exceeds what their covariances say; at least 1.

        It is the square of Birge's ratio, the chi-square per degree of freedom (Birge 1932, "The calculation of errors
        by the method of least squares").
        """
        return max(1.0, self.chi_square(chosen) / _freedom(chosen)) if len(chosen) > 1 else 1.0

    def difference(self, some: Sequence[int], others: Sequence[int]) -> tuple[FloatArray, float]:
        """Return the difference of the mean of some from that of others, shape (3,), and its Mahalanobis distance."""
        mean, covariance = self.mean(some)
        reference, other_covariance = self.mean(others)
        off = mean - reference
        return off, float(np.sqrt(off @ np.linalg.solve(covariance + other_covariance, off)))

    def distances(self, chosen: Sequence[int]) -> FloatArray:
        """Return the Mahalanobis distance of each of some estimates from all the others of them together."""
        return np.array([self.difference([i], [j for j in chosen if j != i])[1] for i in chosen])


def weighted_mean(values: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean of independent estimates, shape (n, 3), weighted by their information, and its covariance."""
    information = np.linalg.inv(covariances)
    covariance: FloatArray = np.linalg.inv(information.sum(axis=0))
    mean: FloatArray = covariance @ np.einsum("nij,nj->i", information, values)
    return mean, covariance


def _freedom(chosen: Sequence[int]) -> int:
    return 3 * (len(chosen) - 1)
