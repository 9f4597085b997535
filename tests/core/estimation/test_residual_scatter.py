from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.estimation.residual_scatter import Blocks, grown, scatter
from laci_stereo.core.frames import FloatArray

ROWS, SIZE = 12, 5


def fitted(rng: np.random.Generator, blocks: int, common: float) -> tuple[FloatArray, FloatArray, FloatArray, Blocks]:
    """Draw parameters as expected, and rows of unit noise, of which a share is common to each block; fit by all.

    Returns
    -------
    error, inverse, precision, part
    """
    design = rng.normal(size=(blocks, ROWS, SIZE)) + 2.0 * rng.normal(size=(blocks, 1, SIZE))
    precision = np.diag(np.full(SIZE, 0.5))
    true = rng.normal(size=SIZE) / np.sqrt(0.5)
    own, alike = rng.normal(size=(blocks, ROWS)), rng.normal(size=(blocks, 1))
    y = design @ true + np.sqrt(1.0 - common) * own + np.sqrt(common) * alike
    told = np.einsum("bri,brj->bij", design, design)
    inverse = np.linalg.inv(precision + told.sum(axis=0))
    found = inverse @ np.einsum("bri,br->i", design, y)
    scores = np.einsum("bri,br->bi", design, y - design @ found)
    return found - true, inverse, precision, Blocks(np.arange(SIZE), scores, told)


@pytest.mark.parametrize("blocks", [4, 7, 30])
def test_where_the_model_is_right_the_scatter_is_the_information(blocks: int) -> None:
    rng = np.random.default_rng(0)
    total = np.zeros((SIZE, SIZE))
    for _ in range(1000):
        _, inverse, precision, part = fitted(rng, blocks, 0.0)
        total += scatter(np.linalg.cholesky(inverse), precision, [part]) / 1000
    np.testing.assert_allclose(total, np.eye(SIZE), atol=0.1)


def test_what_a_block_has_in_common_is_in_the_covariance() -> None:
    rng = np.random.default_rng(1)
    modelled, allowed = [], []
    for _ in range(300):
        error, inverse, precision, part = fitted(rng, 100, 0.5)
        modelled.append(error @ np.linalg.solve(inverse, error) / SIZE)
        allowed.append(error @ np.linalg.solve(grown(inverse, precision, [part]), error) / SIZE)
    assert np.mean(modelled) > 4.0
    assert 0.8 < np.mean(allowed) < 1.3


def test_parameters_of_others_are_left_alone() -> None:
    _, inverse, precision, part = fitted(np.random.default_rng(2), 7, 0.8)
    wide = np.zeros((SIZE + 2, SIZE + 2))
    wide[:SIZE, :SIZE], wide[SIZE:, SIZE:] = inverse, 2.0 * np.eye(2)
    known = np.zeros_like(wide)
    known[:SIZE, :SIZE], known[SIZE:, SIZE:] = precision, np.eye(2) / 2.0
    found = grown(wide, known, [part])
    np.testing.assert_allclose(found[:SIZE, :SIZE], grown(inverse, precision, [part]), atol=1e-12)
    np.testing.assert_allclose(found[SIZE:, SIZE:], 2.0 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(found[SIZE:, :SIZE], 0.0, atol=1e-12)
