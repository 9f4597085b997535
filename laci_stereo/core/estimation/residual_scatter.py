"""By how much the dispersion of the residuals exceeds what the model of their noise expects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray

LEAST_LEFT = 0.1
"""Least fraction of all information that is attributed to the other blocks: if a block had more than nine tenths of it,
its scores would be remainders of the descent."""


@dataclass(frozen=True)
class Blocks:
    """Blocks of residuals, each of which counts as one independent sample.

    Attributes
    ----------
    index : ndarray of int, shape (q,)
        Indices of the parameters that the blocks depend on.
    scores : ndarray, shape (b, q)
        Gradient of the log-likelihood of each block, of either sign.
    told : ndarray, shape (b, q, q)
        Information of each block, if the model is right.
    """

    index: IntArray
    scores: FloatArray
    told: FloatArray


def scatter(root: FloatArray, precision: FloatArray, parts: Sequence[Blocks]) -> FloatArray:
    """Return the dispersion of the scores, shape (p, p), in units of the information.

    It is the identity if the model is right. The scores within a block are summed (cluster-robust, Huber 1967): where
    its residuals agree more than the model expects, the squares of the sums grow. Residuals are smaller than errors,
    since the estimate has followed them. The scores of a block are therefore enlarged according to its fraction of all
    information (Bell and McCaffrey 2002, "bias reduced linearization"), so that the mean is the identity however few
    blocks there are.

    Parameters
    ----------
    root : ndarray, shape (p, p)
        Lower triangular root of the inverse of all information.
    precision : ndarray, shape (p, p)
        Precision of the prior.
    parts : sequence of Blocks
        Blocks that each depend on their own subset of the parameters.
    """
    total: FloatArray = root.T @ precision @ root
    for part in parts:
        # A part's scores lie in the subspace of its own parameters.
        basis, factor = np.linalg.qr(root[part.index].T)
        shares, ways = np.linalg.eigh(factor @ part.told @ factor.T)
        along = np.einsum("bji,jk,bk->bi", ways, factor, part.scores)
        left = np.sqrt(np.maximum(1.0 - shares, LEAST_LEFT))
        pulls = np.einsum("bij,bj->bi", ways, along / left) @ basis.T
        total += pulls.T @ pulls
    return total


def without_prior(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points' own information, shape (p, p), and pull, shape (p,): the posterior's less the prior's.

    The pull is the information times the estimate. Where the residuals are more dispersed than the model expects, the
    difference can have negative eigenvalues, which are no information.
    """
    values, vectors = np.linalg.eigh(information)
    told = vectors[:, values > 0.0]
    return (vectors * np.maximum(values, 0.0)) @ vectors.T, told @ (told.T @ pull)


def grown(inverse: FloatArray, precision: FloatArray, parts: Sequence[Blocks]) -> FloatArray:
    """Return the inverse of all information, shape (p, p), enlarged where the scores are more dispersed than expected.

    The enlargement is by direction. Parameters are those of `scatter`.
    """
    root = np.asarray(np.linalg.cholesky(inverse), dtype=np.float64)
    values, ways = np.linalg.eigh(scatter(root, precision, parts))
    found: FloatArray = root @ (ways * np.maximum(values, 1.0)) @ ways.T @ root.T
    return found
