"""A scene's map has its kerbs and walls where its bodies have them, and paint is what shines."""

from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray
from tools.scenes.geometry import Material, RayCaster
from tools.scenes.scene import draw_scene, own_axes, swept_frame
from tools.scenes.world import LAYOUTS, PAVEMENT_M, LayoutKind, build_site, draw_road

DOWN = np.array([0.0, 0.0, -1.0])
BESIDE_M = 0.02


def middles(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middle of each piece of a line, shape (n, 2), and unit vectors to its left."""
    ahead = np.diff(xy, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return (xy[1:] + xy[:-1]) / 2, np.column_stack([-ahead[:, 1], ahead[:, 0]])


def heights(caster: RayCaster, xy: FloatArray) -> FloatArray:
    origins = np.column_stack([xy, np.full(len(xy), 50.0)])
    return 50.0 - caster.cast(origins, np.tile(DOWN, (len(xy), 1)), 0.0).distance_m


@pytest.mark.parametrize("kind", LAYOUTS)
def test_kerbs_of_the_map_are_steps_as_high_as_the_roads(kind: LayoutKind) -> None:
    road = draw_road(np.random.default_rng(3), kind, uneven=0.0)
    site = build_site(np.random.default_rng(4), road, [], 0.0)
    caster = RayCaster(site.bodies)
    kerbs = [edge for edge in site.edges if edge.kind == "curbstone"]
    assert kerbs
    for kerb in kerbs:
        at, left = middles(kerb.xy)
        at, left = at[np.linalg.norm(at, axis=1) < 60.0], left[np.linalg.norm(at, axis=1) < 60.0]
        step = np.abs(heights(caster, at + BESIDE_M * left) - heights(caster, at - BESIDE_M * left))
        assert (step > road.kerb_m - 2e-3).all()
        # At a corner the pavement has risen by as much as it is wide between the streets' lines.
        assert (step < road.kerb_m + 0.025 * PAVEMENT_M + 2e-3).all()


@pytest.mark.parametrize("kind", LAYOUTS)
def test_verges_begin_where_the_map_has_the_roads_edge_and_fall_away_from_it(kind: LayoutKind) -> None:
    road = draw_road(np.random.default_rng(3), kind, uneven=0.0, verges=True)
    assert road.verge is not None
    assert 0.0 < road.verge < 0.12
    site = build_site(np.random.default_rng(4), road, [], 0.0)
    caster = RayCaster(site.bodies)
    borders = [edge for edge in site.edges if edge.kind == "road_border"]
    assert borders
    for border in borders:
        at, left = middles(border.xy)
        straight = (np.linalg.norm(at, axis=1) > 32.0) & (np.linalg.norm(at, axis=1) < 60.0)
        at, left = at[straight], left[straight]
        one, other = (heights(caster, at + way * 1.5 * left) for way in (1.0, -1.0))
        np.testing.assert_allclose(np.abs(one - other), 1.5 * road.verge, atol=2e-3)
        step = np.abs(heights(caster, at + BESIDE_M * left) - heights(caster, at - BESIDE_M * left))
        assert (step < BESIDE_M * road.verge + 2e-3).all()


def test_walls_of_the_map_are_where_something_stands() -> None:
    road = draw_road(np.random.default_rng(3), "cross")
    site = build_site(np.random.default_rng(6), road, [], 1.0)
    walls = [edge for edge in site.edges if edge.kind == "wall"]
    assert len(walls) > 8
    caster = RayCaster([body for body in site.bodies if body.name.startswith(("house", "wall"))])
    for wall in walls:
        at, left = middles(wall.xy)
        beside = np.concatenate([at + BESIDE_M * left, at - BESIDE_M * left])
        assert np.isfinite(heights(caster, beside)).any()


def test_paint_throws_back_more_light_than_the_road() -> None:
    scene = draw_scene(8, "lidar_64", frames=60, rain=0.0, density=0.0, vehicles=0, walkers=0, cyclists=0, parked=0)
    swept = swept_frame(scene, 0)
    to_world = scene.T_world_sensor @ own_axes(scene)
    origin = to_world[:3, 3]
    rays = swept.points @ to_world[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = scene.caster.cast(np.tile(origin, (len(rays), 1)), rays, float(scene.times_s[0]))
    near = (hits.body >= 0) & (hits.distance_m < 25.0)
    material = scene.caster.materials[scene.caster.faces(hits)]
    paint, road = (swept.intensity[near & (material == kind)] for kind in (Material.PAINT, Material.ROAD))
    assert len(paint) > 50
    assert np.median(paint) > 2 * np.median(road)
    assert swept.intensity.min() >= 0.0
    assert swept.intensity.max() <= 255.0
