from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("embreex")

from tools.scenes.geometry import Material, merged
from tools.scenes.vehicles import CARS, KINDS, draw_vehicle, without_mirrors


def with_what_it_tells_of(vehicle):
    """A lorry's length is told with its semi-trailer."""
    if vehicle.kind != "trailer":
        return vehicle
    T = np.eye(4)
    T[0, 3] = vehicle.trailer.hitch_m - vehicle.trailer.axle_m - vehicle.trailer.drawbar_m
    return replace(vehicle, mesh=merged([vehicle.trailer.mesh.moved(T), vehicle.mesh]))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
def test_the_body_spans_the_stated_box(kind, seed):
    vehicle = draw_vehicle(np.random.default_rng(seed), kind)
    vertices = without_mirrors(with_what_it_tells_of(vehicle)).vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    np.testing.assert_allclose(high[:2], [vehicle.length_m / 2, vehicle.width_m / 2], atol=1e-9)
    np.testing.assert_allclose(low[:2], [-vehicle.length_m / 2, -vehicle.width_m / 2], atol=1e-9)
    np.testing.assert_allclose([low[2], high[2]], [0.0, vehicle.height_m], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_mirrors_stand_out_at_the_sides_alone(kind):
    vehicle = draw_vehicle(np.random.default_rng(2), kind)
    span = np.ptp(with_what_it_tells_of(vehicle).mesh.vertices, axis=0)
    assert span[0] == pytest.approx(vehicle.length_m)
    assert span[1] == pytest.approx(vehicle.mirror_width_m)
    assert vehicle.mirror_width_m > vehicle.width_m + 0.15


@pytest.mark.parametrize("kind", KINDS)
def test_axles_are_under_the_vehicle(kind):
    vehicle = draw_vehicle(np.random.default_rng(4), kind)
    assert -vehicle.length_m / 2 < vehicle.rear_axle_m
    assert (vehicle.rear_axle_m > 0.0) == (kind == "trailer")  # a tractor's is in the front third
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


@pytest.mark.parametrize("seed", range(5))
def test_a_lorry_with_its_trailer_is_as_long_as_allowed(seed):
    vehicle = draw_vehicle(np.random.default_rng(seed), "trailer")
    assert 14.5 < vehicle.length_m <= 16.5


@pytest.mark.parametrize("seed", range(5))
def test_a_caravan_hangs_behind_its_car_and_touches_it_nowhere(seed):
    vehicle = draw_vehicle(np.random.default_rng(seed), "caravan")
    trailer = vehicle.trailer
    box = trailer.mesh.vertices[trailer.mesh.vertices[:, 2] > 0.6]
    front_m = trailer.hitch_m + box[:, 0].max() - trailer.axle_m - trailer.drawbar_m
    assert vehicle.mesh.vertices[:, 0].min() - front_m > 0.5


def test_vehicles_differ_and_follow_their_seed():
    lengths = {draw_vehicle(np.random.default_rng(seed), "saloon").length_m for seed in range(10)}
    assert len(lengths) == 10
    one, two = (draw_vehicle(np.random.default_rng(5), "suv") for _ in range(2))
    np.testing.assert_array_equal(one.mesh.vertices, two.mesh.vertices)
