"""The scene at rest, and its road."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.stereo.scene import SHRINK, Look, RoadDisparity, learn_look, regions, shrink
from tests.stereo.render import Box, Mounting, trace, turned
from tests.stereo.rigs import RIGS
from tests.stereo.support import MOUNTING, rectification, truth

SHAPE = (60, 80)
NOISE = 1.5


def rest(seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(30, 200, SHAPE)


def frame(grey: FloatArray, rng: np.random.Generator) -> Raster:
    return np.clip(np.rint(grey + rng.normal(0, NOISE, grey.shape)), 0, 255).astype(np.uint8)


def other(grey: FloatArray) -> FloatArray:
    """Return grey values that are different in every pixel."""
    return np.where(grey > 110, grey - 70, grey + 70)


def learn(frames: int = 15, gains: tuple[float, ...] = (1.0,)) -> Look:
    rng = np.random.default_rng(1)
    return learn_look([frame(gains[i % len(gains)] * rest(), rng) for i in range(frames)])


def ground(mounting: Mounting) -> GroundPlane:
    normal = mounting.R_road_left[2]
    return GroundPlane(normal, mounting.height_m, np.zeros((4, 4)), 1.0, 100, 1.0, 100.0, 0.0)


def test_noise_is_no_change() -> None:
    look, rng = learn(), np.random.default_rng(2)
    for _ in range(20):
        assert not look.changed(frame(rest(), rng)).any()


@pytest.mark.parametrize("gain", [0.6, 0.7, 1.25])
def test_light_is_no_change_and_a_mover_is_one(gain: float) -> None:
    look, rng = learn(), np.random.default_rng(2)
    grey = gain * rest()
    assert not look.changed(frame(grey, rng)).any()
    grey[20:40, 30:60] = other(grey[20:40, 30:60])
    changed = look.changed(frame(grey, rng))
    assert changed[21:39, 31:59].all()
    changed[18:42, 28:62] = False
    assert not changed.any()


@pytest.mark.parametrize("gains", [(1.0, 0.7), (0.7, 0.7, 1.0), (1.0, 1.4)])
def test_what_is_learnt_does_not_depend_on_the_light(gains: tuple[float, ...]) -> None:
    look, rng = learn(gains=gains), np.random.default_rng(2)
    assert np.median(look.noise) < 2 * NOISE
    for gain in gains:
        grey = gain * rest()
        assert not look.changed(frame(grey, rng)).any()
        grey[20:40, 30:60] = other(grey[20:40, 30:60])
        assert look.changed(frame(grey, rng))[21:39, 31:59].all()


def test_what_was_too_bright_to_be_told_has_not_changed() -> None:
    bright = rest()
    bright[:20] = 330.0
    rng = np.random.default_rng(3)
    look = learn_look([frame(bright, rng) for _ in range(9)])
    assert not look.changed(frame(0.7 * bright, rng)).any()
    assert not look.changed(frame(1.2 * bright, rng)).any()


def test_a_hole_in_a_change_is_filled() -> None:
    look, grey = learn(), rest()
    grey[20:40, 30:60] = other(grey[20:40, 30:60])
    grey[28:32, 42:48] = rest()[28:32, 42:48]
    assert look.changed(frame(grey, np.random.default_rng(2)))[21:39, 31:59].all()


def test_what_moves_in_few_frames_leaves_no_trace() -> None:
    rng = np.random.default_rng(1)
    frames = [rest() for _ in range(15)]
    for grey in frames[::3]:
        grey[20:40, 30:60] = 10.0
    look = learn_look([frame(grey, rng) for grey in frames])
    np.testing.assert_allclose(look.image, rest(), atol=5 * NOISE)
    assert look.changed(frame(frames[0], rng))[21:39, 31:59].all()


@pytest.mark.parametrize("seen_in", [0.15, 0.35, 0.5, 0.65, 0.85])
def test_what_looks_in_two_ways_is_always_changed(seen_in: float) -> None:
    """One is the scene's, and the other that of what dwells in front of it: a place that is empty tells which."""
    rng = np.random.default_rng(1)
    frames = [rest() for _ in range(31)]
    for grey in frames[: round(seen_in * len(frames))]:
        grey[20:40, 30:60] = other(grey[20:40, 30:60])
    look = learn_look([frame(grey, rng) for grey in frames])
    assert not look.settled[21:39, 31:59].any()
    for grey in (frames[0], frames[-1]):
        changed = look.changed(frame(grey, rng))
        assert changed[21:39, 31:59].all()
        changed[18:42, 28:62] = False
        assert not changed.any()


@pytest.mark.parametrize("seen_in", [0.3, 0.5, 0.65])
def test_a_queue_in_which_each_looks_otherwise_is_not_taken_for_the_scene(seen_in: float) -> None:
    rng = np.random.default_rng(1)
    inside = np.s_[22:38, 32:58]
    frames = [rest() for _ in range(31)]
    for number in range(round(seen_in * len(frames))):
        frames[number][20:40, 30:60] = rest(seed=number + 1)[20:40, 30:60]
    look = learn_look([frame(grey, rng) for grey in frames])
    wrong = look.settled & (np.abs(look.image - rest()) > 5 * NOISE)
    assert wrong[inside].mean() < 0.05
    for grey in frames[:3]:
        assert look.changed(frame(grey, rng))[inside].mean() > 0.98


@pytest.mark.parametrize("frames", [1, 2, 3, 6, 12, 30, 31])
def test_leaves_that_sway_are_the_scene_however_few_frames_there_are(frames: int) -> None:
    rng = np.random.default_rng(1)
    restless = np.zeros(SHAPE)
    restless[:, :30] = 10.0
    look = learn_look([frame(rest() + restless * rng.normal(size=SHAPE), rng) for _ in range(frames)])
    assert look.settled.all()
    grey = rest()
    grey[20:40, 40:60] = other(grey[20:40, 40:60])
    assert look.changed(frame(grey, rng))[21:39, 41:59].all()


def test_an_edge_that_sways_with_the_mast_is_not_what_dwells() -> None:
    rng = np.random.default_rng(1)
    stripes = np.where(np.arange(SHAPE[1]) % 20 < 10, 60.0, 180.0) + np.zeros(SHAPE)
    look = learn_look([frame(np.roll(stripes, int(rng.integers(-1, 2)), axis=1), rng) for _ in range(31)])
    assert look.settled.all()


def test_a_pixel_that_is_restless_needs_more() -> None:
    rng = np.random.default_rng(1)
    restless = np.zeros(SHAPE)
    restless[:, :30] = 10.0
    look = learn_look([frame(rest() + restless * rng.normal(size=SHAPE), rng) for _ in range(31)])
    assert np.median(look.noise[:, :25]) > 4 * np.median(look.noise[:, 35:])
    assert look.settled.all()
    assert not look.changed(frame(rest() + restless * rng.normal(size=SHAPE), rng)).any()


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("mounting", [MOUNTING, Mounting(9.0, 35.0, -3.0), Mounting(4.0, 12.0, 2.0)])
def test_the_road_is_a_plane_of_disparity(name: str, mounting: Mounting) -> None:
    plane = rectification(name)
    road = RoadDisparity.of(ground(mounting), plane)
    eye = np.array([0.0, 0.0, mounting.height_m])
    depth, _ = trace(eye, turned(plane.rays.reshape(-1, 3), mounting.R_road_left), [])
    v, u = (a.ravel() for a in np.mgrid[: plane.size[1], : plane.size[0]])
    disparity = road.row @ np.stack([u, v, np.ones_like(u)])
    hit = depth > 0
    np.testing.assert_allclose(disparity[hit], (plane.focal_px * plane.baseline_m / depth[hit]), rtol=1e-6)
    assert (disparity[~hit] <= 1e-9).all()


@pytest.mark.parametrize("name", ["ideal", "twelve", "mirrored askew", "fisheye"])
@pytest.mark.parametrize("near_m", [7.0, 12.0, 30.0])
def test_the_search_reaches_from_the_road_to_the_tallest_vehicle(name: str, near_m: float) -> None:
    lorry = Box(near_m + 4.0, 0.5, 0.1, length_m=8.0, width_m=2.5, height_m=4.0)
    plane, seen = rectification(name), truth(name, [lorry])
    road = RoadDisparity.of(ground(MOUNTING), plane)
    v, u = np.nonzero(seen.owner == 1)
    corners = (int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1)
    smallest, largest = road.range(*corners)
    inside = seen.disparity[corners[1] : corners[3], corners[0] : corners[2]]
    assert smallest <= inside[inside > 0].min()
    assert largest >= inside.max()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 59), st.integers(0, 79), st.integers(1, 30), st.integers(1, 30)), max_size=6))
def test_regions_cover_every_change_and_do_not_overlap(patches: list[tuple[int, int, int, int]]) -> None:
    changed = np.zeros(SHAPE, dtype=bool)
    for v, u, height, width in patches:
        changed[v : v + height, u : u + width] = True
    size = (SHRINK * SHAPE[1], SHRINK * SHAPE[0])
    times = np.zeros(size[::-1], dtype=int)
    for region in regions(changed, size, RoadDisparity(np.array([0.0, 0.1, 0.0]), 6.0)):
        assert 0 <= region.x0 < region.x1 <= size[0]
        assert 0 <= region.y0 < region.y1 <= size[1]
        times[region.y0 : region.y1, region.x0 : region.x1] += 1
    assert times.max() <= 1
    assert times[np.kron(changed, np.ones((SHRINK, SHRINK))) > 0].all()
    assert len(regions(np.zeros(SHAPE, dtype=bool), size, RoadDisparity(np.zeros(3), 6.0))) == 0


def test_shrinking_averages() -> None:
    image = np.random.default_rng(0).integers(0, 255, (40, 60)).astype(np.uint8)
    np.testing.assert_allclose(shrink(image), image.reshape(20, 2, 30, 2).mean(axis=(1, 3)), atol=0.51)
