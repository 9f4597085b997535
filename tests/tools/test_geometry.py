import numpy as np
import pytest

pytest.importorskip("embreex")

from laci_stereo.core.frames import planar
from tools.scenes.geometry import Body, Hits, Material, Mesh, RayCaster, merged
from tools.scenes.shapes import box, wheel
from tools.scenes.world import still

PLANE = Mesh(
    np.array([[-200.0, -200.0, 0.0], [200.0, -200.0, 0.0], [-200.0, 200.0, 0.0], [200.0, 200.0, 0.0]]),
    np.array([[0, 1, 2], [1, 3, 2]]),
    np.full(2, Material.ROAD, dtype=np.int64),
)
BOX = box((-2.0, -1.0, 0.0), (2.0, 1.0, 1.5), Material.CAR_PAINT)


def some_directions(count: int = 20_000) -> np.ndarray:
    directions = np.random.default_rng(3).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def scene(pose=lambda time_s: planar(0.3, np.array([20.0 + 8.0 * time_s, 3.0])), static: bool = False) -> RayCaster:
    return RayCaster([Body("road", PLANE, still(np.eye(4)), True), Body("box", BOX, pose, static)])


def entered(origin: np.ndarray, directions: np.ndarray, T_world_box: np.ndarray) -> np.ndarray:
    """Slabs: where rays enter the box; inf where they miss it."""
    start = (origin - T_world_box[:3, 3]) @ T_world_box[:3, :3]
    rays = directions @ T_world_box[:3, :3]
    first, second = (np.array([-2.0, -1.0, 0.0]) - start) / rays, (np.array([2.0, 1.0, 1.5]) - start) / rays
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


@pytest.mark.parametrize("static", [False, True])
def test_a_plane_and_a_box_are_hit_where_geometry_says(static):
    origin, directions = np.array([1.0, 2.0, 6.0]), some_directions()
    directions[:5000] = np.array([20.0, 3.0, 1.0]) - origin + 2.0 * np.random.default_rng(1).normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    pose = planar(0.3, np.array([20.0, 3.0]))
    hits = scene(still(pose), static).cast(origin, directions, 0.0)
    box_m = entered(origin, directions, pose)
    ground_m = np.where(directions[:, 2] < 0.0, 6.0 / -directions[:, 2].clip(None, -1e-9), np.inf)
    reached = np.flatnonzero(np.isfinite(ground_m))
    outside = np.abs((origin + ground_m[reached, None] * directions[reached])[:, :2]).max(axis=1) > 200.0
    ground_m[reached[outside]] = np.inf
    expected = np.minimum(box_m, ground_m)
    # A ray along an edge may go either way in single precision.
    met = np.isfinite(expected)
    assert (np.abs(hits.distance_m[met] - expected[met]) < 1e-6).mean() > 0.999
    assert np.isinf(hits.distance_m[np.isinf(expected)]).all()
    assert (hits.body == 1).sum() > 1000
    assert (hits.body[box_m < ground_m] == 1).mean() > 0.99


def test_normals_are_unit_and_face_the_origin():
    directions = some_directions()
    hits = scene().cast(np.array([0.0, 0.0, 5.0]), directions, 0.0)
    met = hits.body >= 0
    np.testing.assert_allclose(np.linalg.norm(hits.normal[met], axis=1), 1.0, atol=1e-12)
    assert (np.einsum("ij,ij->i", hits.normal[met], directions[met]) <= 0.0).all()
    assert (hits.normal[hits.body == 0] == [0.0, 0.0, 1.0]).all()


def test_triangles_are_told_within_their_own_body():
    other = Body("far", BOX, still(planar(0.0, np.array([0.0, 30.0]))), True)
    caster = RayCaster([Body("near", BOX, still(planar(0.0, np.array([10.0, 0.0]))), True), other])
    hits = caster.cast(np.array([0.0, 30.0, 8.0]), np.array([[0.0, 0.0, -1.0]]), 0.0)
    assert hits.body[0] == 1
    corners = BOX.vertices[BOX.triangles[hits.triangle[0]]]
    np.testing.assert_allclose(corners[:, 2], 1.5)


def test_how_far_it_is_to_what_moves_is_what_a_cast_at_that_alone_finds():
    rng = np.random.default_rng(2)
    origins, directions = rng.uniform([10.0, -8.0, 0.0], [34.0, 12.0, 3.0], (3000, 3)), some_directions(4)
    caster, reach_m = scene(), 6.0
    alone = RayCaster([body for body in caster.bodies if not body.static])
    for time_s in (0.0, 0.4, 0.0):
        found = caster.to_moving(origins, directions, reach_m, time_s)
        expected = np.column_stack(
            [alone.cast(origins, np.tile(each, (len(origins), 1)), time_s).distance_m for each in directions]
        )
        within = expected < reach_m
        assert within.mean() > 0.01
        np.testing.assert_array_equal(found[within], expected[within])
        assert (found[~within] >= reach_m).all()


def test_many_origins_are_as_good_as_one():
    directions, caster = some_directions(), scene()
    one = caster.cast(np.array([2.0, 1.0, 4.0]), directions, 0.4)
    many = caster.cast(np.tile([2.0, 1.0, 4.0], (len(directions), 1)), directions, 0.4)
    for field in ("distance_m", "body", "triangle", "normal"):
        np.testing.assert_array_equal(getattr(one, field), getattr(many, field))


def test_a_sweep_sees_a_mover_where_it_is_at_each_moment():
    """A wall that comes at 8 m/s is nearer at the end of the sweep by what it drove."""
    caster = scene(lambda time_s: planar(0.0, np.array([30.0 - 8.0 * time_s, 0.0])))
    directions = np.tile([1.0, 0.0, 0.0], (200, 1))
    times = np.linspace(0.0, 0.1, 200)
    hits = caster.sweep(np.array([0.0, 0.0, 0.5]), directions, times)
    np.testing.assert_allclose(hits.distance_m, 28.0 - 8.0 * times, atol=1e-6)
    still_standing: Hits = caster.cast(np.array([0.0, 0.0, 0.5]), directions, 0.05)
    np.testing.assert_allclose(still_standing.distance_m, 28.0 - 0.4, atol=1e-9)


def test_merged_meshes_keep_their_triangles():
    together = merged([PLANE, BOX])
    np.testing.assert_array_equal(together.vertices[together.triangles[2:]], BOX.vertices[BOX.triangles])


def test_a_wheel_stands_on_the_ground():
    mesh = wheel(1.2, 0.8, 0.33, 0.2)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    np.testing.assert_allclose([low[2], high[2]], [0.0, 0.66], atol=1e-9)
    np.testing.assert_allclose([low[1], high[1]], [0.7, 0.9], atol=1e-9)


def test_what_stands_still_need_not_be_cast_again():
    directions, caster, origin = some_directions(), scene(), np.array([2.0, 1.0, 4.0])
    still_hits = caster.still(origin, directions)
    for time_s in (0.0, 1.5):
        again, whole = caster.before(still_hits, origin, directions, time_s), caster.cast(origin, directions, time_s)
        np.testing.assert_array_equal(again.distance_m, whole.distance_m)
        np.testing.assert_array_equal(again.body, whole.body)


def test_faces_tell_the_material_of_what_is_hit():
    directions, caster = some_directions(), scene()
    hits = caster.cast(np.array([16.0, 1.0, 4.0]), directions, 0.0)
    material = np.append(caster.materials, -1)[caster.faces(hits)]
    np.testing.assert_array_equal(material == Material.CAR_PAINT, hits.body == 1)
    np.testing.assert_array_equal(material == Material.ROAD, hits.body == 0)
    np.testing.assert_array_equal(material == -1, hits.body == -1)


def test_a_sweep_meets_a_turning_body_as_its_pose_at_each_moment_does():
    """A car that turns by 1 rad/s: between the moments at which its pose is asked for it is off by less than 0.1 mm."""
    caster = scene(lambda time_s: planar(1.0 * time_s, np.array([12.0 * time_s, 8.0])))
    directions = np.tile([0.0, 1.0, 0.0], (100, 1))
    times = np.linspace(0.0, 0.1, 100)
    origin = np.array([0.5, 0.0, 0.5])
    swept = caster.sweep(origin, directions, times)
    single = [caster.cast(origin, directions[:1], float(time_s)).distance_m[0] for time_s in times]
    np.testing.assert_allclose(swept.distance_m, single, atol=1e-4)
