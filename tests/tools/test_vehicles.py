import numpy as np
import pytest

pytest.importorskip("embreex")

from tools.scenes.geometry import Material
from tools.scenes.vehicles import CARS, KINDS, draw_vehicle, without_mirrors


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
def test_the_body_spans_the_stated_box(kind, seed):
    vehicle = draw_vehicle(np.random.default_rng(seed), kind)
    vertices = without_mirrors(vehicle).vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    np.testing.assert_allclose(high[:2], [vehicle.length_m / 2, vehicle.width_m / 2], atol=1e-9)
    np.testing.assert_allclose(low[:2], [-vehicle.length_m / 2, -vehicle.width_m / 2], atol=1e-9)
    np.testing.assert_allclose([low[2], high[2]], [0.0, vehicle.height_m], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_mirrors_stand_out_at_the_sides_alone(kind):
    vehicle = draw_vehicle(np.random.default_rng(2), kind)
    span = np.ptp(vehicle.mesh.vertices, axis=0)
    assert span[0] == pytest.approx(vehicle.length_m)
    assert span[1] == pytest.approx(vehicle.mirror_width_m)
    assert vehicle.mirror_width_m > vehicle.width_m + 0.15


@pytest.mark.parametrize("kind", KINDS)
def test_axles_are_under_the_vehicle(kind):
    vehicle = draw_vehicle(np.random.default_rng(4), kind)
    assert -vehicle.length_m / 2 < vehicle.rear_axle_m < 0.0
    assert 0.0 < vehicle.rear_axle_m + vehicle.wheelbase_m < vehicle.length_m / 2


@pytest.mark.parametrize("kind", [kind for kind, _ in CARS])
def test_cars_have_windows_in_front_and_narrow_towards_the_roof(kind):
    vehicle = draw_vehicle(np.random.default_rng(1), kind)
    mesh = vehicle.mesh
    glass = mesh.vertices[mesh.triangles[mesh.material == Material.GLASS]].mean(axis=1)
    assert glass[:, 0].max() > 0.05 * vehicle.length_m
    assert glass[:, 2].min() > 0.4 * vehicle.height_m
    body = without_mirrors(vehicle).vertices
    roof = body[body[:, 2] > vehicle.height_m - 0.07]
    assert np.ptp(roof[:, 1]) < vehicle.width_m - 0.05


def test_vehicles_differ_and_follow_their_seed():
    lengths = {draw_vehicle(np.random.default_rng(seed), "saloon").length_m for seed in range(10)}
    assert len(lengths) == 10
    one, two = (draw_vehicle(np.random.default_rng(5), "suv") for _ in range(2))
    np.testing.assert_array_equal(one.mesh.vertices, two.mesh.vertices)
