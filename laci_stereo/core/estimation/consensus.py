"""Several estimates of the same three numbers, and how far they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from laci_stereo.core.frames import FloatArray


@dataclass(frozen=True)
class Estimates:
    """Estimates of three numbers, whose errors may be correlated.

    Attributes
    ----------
    values : ndarray, shape (n, 3)
    covariance : ndarray, shape (n, 3, n, 3)
        Of the errors of all of them.
    """

    values: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.values)

    def mean(self, chosen: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the weighted mean of some estimates, shape (3,), and its covariance, shape (3, 3)."""
        return self._combined(self._weights(chosen))

    def chi_square(self, chosen: Sequence[int]) -> float:
        """Return the squared Mahalanobis distance of some estimates from their mean."""
        off = self._off(chosen)
        return float(np.einsum("ni,nimj,mj->", off, self._contrasts(chosen), off))

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
        off, covariance = self._combined(self._weights(some) - self._weights(others))
        return off, float(np.sqrt(off @ np.linalg.solve(covariance, off)))

    def distances(self, chosen: Sequence[int]) -> FloatArray:
        """Return the Mahalanobis distance of each of some estimates from what all the others of them tell of it.

        Its square is by how much chi-square falls without that estimate.
        """
        contrasts, each = self._contrasts(chosen), range(len(chosen))
        pulls = np.einsum("nimj,mj->ni", contrasts, self._off(chosen))
        squares = np.einsum("ni,nij,nj->n", pulls, np.linalg.inv(contrasts[each, :, each]), pulls)
        return np.asarray(np.sqrt(squares), dtype=np.float64)

    def _off(self, chosen: Sequence[int]) -> FloatArray:
        """Return by how much some estimates differ from the first of them, shape (k, 3): equal ones by nothing."""
        off: FloatArray = self.values[list(chosen)] - self.values[chosen[0]]
        return off

    def _information(self, chosen: Sequence[int]) -> FloatArray:
        """Return the inverse covariance of some estimates, shape (k, 3, k, 3)."""
        shape = (len(chosen), 3, len(chosen), 3)
        some = self.covariance[np.ix_(chosen, range(3), chosen, range(3))].reshape(3 * len(chosen), -1)
        return np.asarray(np.linalg.inv(some), dtype=np.float64).reshape(shape)

    def _contrasts(self, chosen: Sequence[int]) -> FloatArray:
        """Return the information of some estimates without that about their mean, shape (k, 3, k, 3)."""
        information = self._information(chosen)
        by_mean = information.sum(axis=0)
        of_mean = np.linalg.inv(by_mean.sum(axis=1))
        contrasts: FloatArray = information - np.einsum("ani,ab,bmj->nimj", by_mean, of_mean, by_mean)
        return contrasts

    def _weights(self, chosen: Sequence[int]) -> FloatArray:
        """Return the weights of the estimates in the mean of some that is most certain, shape (3, n, 3)."""
        by_mean = self._information(chosen).sum(axis=0)
        weights = np.zeros((3, *self.values.shape))
        weights[:, list(chosen)] = np.einsum("ab,bni->ani", np.linalg.inv(by_mean.sum(axis=1)), by_mean)
        return weights

    def _combined(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sum of the weighted estimates, shape (3,), and its covariance, shape (3, 3)."""
        value: FloatArray = np.einsum("ani,ni->a", weights, self.values)
        covariance: FloatArray = np.einsum("ani,nimj,bmj->ab", weights, self.covariance, weights)
        return value, covariance


def uncorrelated(covariances: FloatArray) -> FloatArray:
    """Return the covariance, shape (n, 3, n, 3), of independent estimates with covariances of shape (n, 3, 3)."""
    each = range(len(covariances))
    joint = np.zeros((len(each), 3, len(each), 3))
    joint[each, :, each] = covariances
    return joint


def _freedom(chosen: Sequence[int]) -> int:
    return 3 * (len(chosen) - 1)
