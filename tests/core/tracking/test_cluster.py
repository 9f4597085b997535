from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import ClusterSettings
from laci_stereo.core.tracking.cluster import cells_of, cluster

SETTINGS = ClusterSettings()
seeds = st.integers(0, 10_000)


def blobs(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-15.0, 15.0, (rng.integers(1, 8), 2))
    parts = [centre + rng.normal(0.0, 0.4, (rng.integers(1, 60), 2)) for centre in centres]
    return np.concatenate([*parts, rng.uniform(-20.0, 20.0, (20, 2))])


def reference(xy: FloatArray) -> set[frozenset[int]]:
    """DBSCAN by its definition, from the dense points only, on the cells' places."""
    cells = np.floor(xy / SETTINGS.cell_m)
    near = cdist(cells, cells) <= SETTINGS.reach_m / SETTINGS.cell_m
    dense = near.sum(axis=1) >= SETTINGS.min_points
    label = np.arange(len(xy))
    for _ in range(len(xy)):
        spread = np.where(near & dense & dense[:, None], label, len(xy)).min(axis=1)
        if (spread[dense] == label[dense]).all():
            break
        label[dense] = spread[dense]
    return {frozenset(np.flatnonzero(dense & (label == number)).tolist()) for number in np.unique(label[dense])}


def dense_parts(xy: FloatArray, groups: list[IntArray]) -> set[frozenset[int]]:
    cells = np.floor(xy / SETTINGS.cell_m)
    around = (cdist(cells, cells) <= SETTINGS.reach_m / SETTINGS.cell_m).sum(axis=1)
    return {frozenset(int(i) for i in group if around[i] >= SETTINGS.min_points) for group in groups}


@given(seeds)
@settings(deadline=None, max_examples=40)
def test_clusters_are_those_of_the_definition(seed: int) -> None:
    xy = blobs(seed)
    assert dense_parts(xy, cluster(xy, SETTINGS)) == reference(xy)


@given(seeds)
@settings(deadline=None, max_examples=40)
def test_clusters_are_disjoint_and_sorted(seed: int) -> None:
    xy = blobs(seed)
    groups = cluster(xy, SETTINGS)
    members = np.concatenate([*groups, np.zeros(0, dtype=np.int64)])
    assert len(np.unique(members)) == len(members)
    sizes = [len(group) for group in groups]
    assert sizes == sorted(sizes, reverse=True)
    for group in groups:
        distances = cdist(xy[group], xy[group]) + 1e9 * np.eye(len(group))
        assert distances.min(axis=1).max() <= SETTINGS.reach_m + 2 * np.sqrt(2) * SETTINGS.cell_m


@given(seeds, st.integers(-10_000, 10_000), st.integers(-10_000, 10_000))
@settings(deadline=None, max_examples=30)
def test_neither_order_nor_place_matters(seed: int, columns: int, rows: int) -> None:
    xy = (cells := np.floor(blobs(seed) / SETTINGS.cell_m)) * SETTINGS.cell_m + SETTINGS.cell_m / 2
    order = np.random.default_rng(seed).permutation(len(xy))
    moved = (cells[order] + [columns, rows] + 0.5) * SETTINGS.cell_m
    back = [order[group] for group in cluster(moved, SETTINGS)]
    assert dense_parts(xy, back) == dense_parts(xy, cluster(xy, SETTINGS))


def test_two_cars_a_metre_apart_are_two() -> None:
    car = np.stack(np.meshgrid(np.arange(0.0, 4.4, 0.1), np.arange(0.0, 1.8, 0.1)), axis=-1).reshape(-1, 2)
    xy = np.concatenate([car, car + np.array([0.0, 2.8])])
    first, second = cluster(xy, SETTINGS)
    assert {frozenset(first.tolist()), frozenset(second.tolist())} == {
        frozenset(range(len(car))),
        frozenset(range(len(car), 2 * len(car))),
    }


@pytest.mark.parametrize("xy", [np.zeros((0, 2)), np.zeros((4, 2)), np.arange(20.0).reshape(-1, 2) * 5])
def test_nothing_to_find(xy: FloatArray) -> None:
    assert cluster(xy, SETTINGS) == []


def test_points_at_one_place() -> None:
    (only,) = cluster(np.full((50, 2), 3.0), SETTINGS)
    assert sorted(only.tolist()) == list(range(50))


@given(st.lists(st.tuples(st.integers(-(10**6), 10**6), st.integers(-(10**6), 10**6)), min_size=2, max_size=30))
def test_cells_have_their_own_numbers(places: list[tuple[int, int]]) -> None:
    numbers = cells_of((np.array(places) + 0.5) * 0.25, 0.25)
    assert len(np.unique(numbers)) == len(set(places))
