"""How far the scatter of the residuals exceeds what the model of their noise expects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray

LEAST_LEFT = 0.1
"""Of what is known, a block tells at most nine tenths: beyond that its scores are what the descent has left."""


@dataclass(frozen=True)
class Blocks:
    """What some blocks of residuals say, each as one statement.

    Attributes
    ----------
    index : ndarray of int, shape (q,)
        Of which parameters.
    scores : ndarray, shape (b, q)
        The gradient of the log-likelihood by each block.
    told : ndarray, shape (b, q, q)
        The information of each, if the model is right.
    """

    index: IntArray
    scores: FloatArray
    told: FloatArray


def scatter(root: FloatArray, precision: FloatArray, parts: Sequence[Blocks]) -> FloatArray:
    """Return what the scores scatter by, shape (p, p), in units of the information, which is 1 if the model is right.

    The scores of a block are summed as they are (cluster-robust, Huber 1967): where its residuals agree more than the
    model has it, their squares grow. Residuals are smaller than errors, since the estimate has followed them; by as
    much as a block tells of all that is known, its scores are taken for larger (Bell and McCaffrey 2002, "bias reduced
    linearization"), so that the mean is 1 however few blocks there are.

    Parameters
    ----------
    root : ndarray, shape (p, p)
        Lower triangular, of the inverse of all information.
    precision : ndarray, shape (p, p)
        What was known beforehand.
    parts : sequence of Blocks
        Each of its own parameters.
    """
    total: FloatArray = root.T @ precision @ root
    for part in parts:
        # Its scores are in the space of its parameters, which is smaller than that of all.
        basis, factor = np.linalg.qr(root[part.index].T)
        shares, ways = np.linalg.eigh(factor @ part.told @ factor.T)
        along = np.einsum("bji,jk,bk->bi", ways, factor, part.scores)
        left = np.sqrt(np.maximum(1.0 - shares, LEAST_LEFT))
        pulls = np.einsum("bij,bj->bi", ways, along / left) @ basis.T
        total += pulls.T @ pulls
    return total


def grown(inverse: FloatArray, precision: FloatArray, parts: Sequence[Blocks]) -> FloatArray:
    """Return the inverse of all information, shape (p, p), larger in the directions in which the scores scatter more.

    Parameters are those of `scatter`.
    """
    root = np.asarray(np.linalg.cholesky(inverse), dtype=np.float64)
    values, ways = np.linalg.eigh(scatter(root, precision, parts))
    found: FloatArray = root @ (ways * np.maximum(values, 1.0)) @ ways.T @ root.T
    return found
