from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from laci_stereo.core.errors import CamError, SettingError
from laci_stereo.core.frames import FloatArray, rigid, rotation_z, transform
from laci_stereo.core.world import World

GEOD = Geod(ellps="WGS84")
ULM = (48.42, 9.94)

latitudes = st.floats(-79.9, 83.9)
longitudes = st.floats(-180.0, 180.0)


def step(world: World, latitude: float, longitude: float, azimuth: float, metres: float) -> FloatArray:
    """Where a geodesic leads from a position, in the world."""
    lon, lat, _ = GEOD.fwd(longitude, latitude, azimuth, metres)
    return world.from_geodetic(np.array([lat]), np.array([lon]))[0]


@pytest.mark.parametrize(
    ("latitude", "longitude", "crs"),
    [
        (*ULM, "EPSG:32632"),
        (-33.86, 151.2, "EPSG:32756"),
        (52.0, 12.0, "EPSG:32633"),  # a border belongs to the zone in the east
        (52.0, 11.9999, "EPSG:32632"),
        (0.0, -78.5, "EPSG:32617"),  # the equator belongs to the north
        (-1e-7, -78.5, "EPSG:32717"),
        (10.0, 180.0, "EPSG:32601"),
        (10.0, -180.0, "EPSG:32601"),
        (10.0, 179.9999, "EPSG:32660"),
        (60.39, 5.32, "EPSG:32632"),  # Bergen: zone 32 is wider there
        (55.9, 5.32, "EPSG:32631"),
        (78.22, 15.65, "EPSG:32633"),  # Longyearbyen: no zone 32, 34 and 36
        (78.22, 8.9, "EPSG:32631"),
        (78.22, 21.0, "EPSG:32635"),
        (78.22, 41.9, "EPSG:32637"),
        (84.0, -100.0, "EPSG:32614"),
        (-80.0, -100.0, "EPSG:32714"),
    ],
)
def test_zone(latitude: float, longitude: float, crs: str) -> None:
    world = World.around(latitude, longitude, None)
    assert world.crs == crs
    assert all(value == round(value) for value in world.origin_utm)
    assert np.linalg.norm(world.from_geodetic(np.array([latitude]), np.array([longitude]))) < 1.0


@pytest.mark.parametrize("latitude", [84.001, 90.0, -80.001, -90.0])
def test_beyond_utm(latitude: float) -> None:
    with pytest.raises(CamError, match=rf"{abs(latitude):.3f} deg; UTM is defined between -80 and 84 deg"):
        World.around(latitude, 10.0)


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        ("EPSG:4326", "is WGS 84; needed is a UTM zone"),
        ("EPSG:2056", r"is CH1903\+ / LV95; needed is a UTM zone"),
        ("nonsense", "is not known to PROJ"),
        ("EPSG:32612", "is UTM zone 12, but the longitude is 9.940 deg; needed is zone 32"),
        ("EPSG:32660", "is UTM zone 60"),
        ("EPSG:32732", "is of the other hemisphere than the latitude, which is 48.420 deg; needed is .*EPSG:32632"),
    ],
)
def test_wrong_crs(crs: str, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        World.around(*ULM, crs)


@pytest.mark.parametrize("crs", ["EPSG:32633", "epsg:32632", "WGS 84 / UTM zone 32N", "EPSG:25832"])
def test_given_crs(crs: str) -> None:
    world = World.around(*ULM, crs)
    there = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(ULM[1], ULM[0])
    assert world.from_utm(np.array([there]))[0] == pytest.approx([0.0, 0.0], abs=1.0)
    assert world.from_geodetic(np.array([ULM[0]]), np.array([ULM[1]]))[0] == pytest.approx([0.0, 0.0], abs=1.0)


def test_the_next_zone_across_the_date_line_is_near() -> None:
    assert World.around(10.0, 179.99, "EPSG:32601").crs == "EPSG:32601"


@given(latitudes, longitudes, st.floats(-300.0, 300.0), st.floats(-300.0, 300.0))
@settings(max_examples=60, deadline=None)
def test_round_trips(latitude: float, longitude: float, x: float, y: float) -> None:
    world = World.around(latitude, longitude)
    xy = np.array([[x, y], [0.0, 0.0]])
    geodetic = world.to_geodetic(xy)
    assert world.from_geodetic(geodetic[:, 0], geodetic[:, 1]) == pytest.approx(xy, abs=1e-6)
    assert world.from_utm(world.to_utm(xy)) == pytest.approx(xy, abs=1e-6)


@given(latitudes, longitudes, st.floats(-180.0, 180.0))
@settings(max_examples=100, deadline=None)
def test_yaw_is_the_direction_of_a_geodesic(latitude: float, longitude: float, heading: float) -> None:
    # Within metres of the zone's border a step may leave the zone, which changes nothing: the grid goes on.
    world = World.around(latitude, longitude)
    back = step(world, latitude, longitude, heading + 180.0, 5.0)
    ahead = step(world, latitude, longitude, heading, 5.0)
    yaw = world.yaw_from_heading(np.array([heading]), np.array([latitude]), np.array([longitude]))[0]
    along = (ahead - back) / np.linalg.norm(ahead - back)
    across = along[1] * np.cos(yaw) - along[0] * np.sin(yaw)
    assert abs(np.degrees(across)) < 1e-4
    assert along @ [np.cos(yaw), np.sin(yaw)] > 0.0


def test_convergence_has_the_right_sign() -> None:
    # East of the central meridian of the northern half, grid north points west of true north: true north is yaw > 90.
    world = World.around(*ULM)
    yaw = world.yaw_from_heading(np.array([0.0]), np.array([ULM[0]]), np.array([ULM[1]]))
    expected = np.degrees(np.arctan(np.tan(np.radians(ULM[1] - 9.0)) * np.sin(np.radians(ULM[0]))))
    assert np.degrees(yaw[0]) - 90.0 == pytest.approx(expected, abs=1e-3)
    assert expected == pytest.approx(0.703, abs=1e-3)


@given(latitudes, longitudes, st.floats(-180.0, 180.0), st.floats(1.0, 200.0))
@settings(max_examples=100, deadline=None)
def test_metres_are_true(latitude: float, longitude: float, azimuth: float, metres: float) -> None:
    world = World.around(latitude, longitude)
    origin = world.from_geodetic(np.array([latitude]), np.array([longitude]))[0]
    distance = np.linalg.norm(step(world, latitude, longitude, azimuth, metres) - origin)
    assert distance == pytest.approx(metres, rel=1e-5)


@given(st.floats(-3.0, 3.0), st.tuples(*[st.floats(-80.0, 80.0)] * 3), st.tuples(*[st.floats(-80.0, 80.0)] * 3))
@settings(max_examples=50, deadline=None)
def test_utm_from_sensor(yaw: float, shift: tuple[float, ...], centre: tuple[float, ...]) -> None:
    world = World.around(*ULM)
    T_world_sensor = rigid(rotation_z(yaw), np.array(shift))
    there = transform(T_world_sensor, np.array([centre]))
    T_utm_sensor = world.utm_from_sensor(T_world_sensor, there[0])
    assert (T_utm_sensor[:3, :3] == T_world_sensor[:3, :3]).all()
    assert transform(T_utm_sensor, np.array([centre]))[:, :2] == pytest.approx(world.to_utm(there[:, :2]), abs=1e-6)
    assert transform(T_utm_sensor, np.array([centre]))[0, 2] == pytest.approx(there[0, 2])
    assume(np.linalg.norm(there) > 1.0)
    # 100 m from there the scale, which a rigid transform cannot have, is off by no more than 4 cm.
    away = np.array(centre) + np.array([100.0, 0.0, 0.0])
    error = transform(T_utm_sensor, away[None])[:, :2] - world.to_utm(transform(T_world_sensor, away[None])[:, :2])
    assert np.linalg.norm(error) == pytest.approx(100.0 * abs(1 - world.grid_scale), abs=1e-6)
