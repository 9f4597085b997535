from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.ground.road_cells import CELL_M, Cells, Patches
from laci_stereo.core.ground.road_surface import rough, smooth


def seen_at(xy: FloatArray) -> Cells:
    """Return cells that a camera sees at some places, of which no two are in one window."""
    n = len(xy)
    sight = np.repeat(np.arange(n, dtype=np.float64)[:, None], 2, axis=1)
    piece = np.zeros(n, dtype=np.int64)
    return Cells(xy, np.zeros(n), np.ones(n), np.ones(n), xy[:, 1], piece, sight, np.full(n, np.nan))


def every_cell(length_m: float, width_m: float) -> FloatArray:
    sides = (np.arange(CELL_M / 2, side, CELL_M) for side in (length_m, width_m))
    return np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("covariance", [rough, smooth])
def test_means_over_patches_vary_with_one_another_as_all_places_in_them_do(
    covariance: Callable[[FloatArray], FloatArray],
) -> None:
    # Squares of more than 4 m, of which each place has nine in each cell.
    cells = every_cell(80.0, 16.0)
    patches = Patches.of(seen_at(cells))
    within = every_cell(3 * CELL_M, 3 * CELL_M) / 3 - CELL_M / 2
    places = np.array([0, 1, 2, len(patches.xy) // 2, -1])
    fine = [(cells[patches.share[[place]].indices][:, None] + within).reshape(-1, 2) for place in places]
    for own, mine in zip(places, fine, strict=True):
        for other, theirs in zip(places, fine, strict=True):
            away = np.linalg.norm(mine[:, None] - theirs, axis=2)
            found, exact = covariance(patches.apart_m()[own, other]), covariance(away).mean()
            assert found == pytest.approx(exact, abs=0.02 * float(covariance(np.zeros(()))))


def test_covariances_of_patches_of_all_sizes_are_positive_definite() -> None:
    rng = np.random.default_rng(0)
    near, far = rng.uniform(0.0, 8.0, (200, 2)), rng.uniform(0.0, 90.0, (300, 2))
    patches = Patches.of(seen_at(np.unique(np.floor(np.concatenate([near, far]) / CELL_M), axis=0) * CELL_M))
    for covariance in (rough, smooth):
        assert np.linalg.eigvalsh(covariance(patches.apart_m())).min() > 0.0


@pytest.mark.parametrize("width_m", [0.5, 3.0, 12.0])
def test_the_best_plane_of_a_plane_is_that_plane(width_m: float) -> None:
    patches = Patches.of(seen_at(every_cell(40.0, width_m)))
    origin, plane = np.array([11.0, -3.0]), np.array([0.3, 0.02, -0.05])
    height = plane[0] + (patches.xy - origin) @ plane[1:]
    by_heights, by_slopes = patches.best_plane(origin, 3.5)
    assert by_heights @ height + by_slopes @ plane[1:] == pytest.approx(plane)


def test_heights_in_a_line_tell_no_slope_across_it() -> None:
    patches = Patches.of(seen_at(every_cell(40.0, 0.5)))
    by_heights, by_slopes = patches.best_plane(patches.xy.mean(axis=0), 3.5)
    assert by_slopes[2, 1] == pytest.approx(1.0)
    assert by_heights[2] == pytest.approx(0.0, abs=1e-9)
    assert by_slopes[1, 0] < 0.01
