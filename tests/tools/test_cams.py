import numpy as np
import pytest
from pyproj import Geod, Transformer

pytest.importorskip("embreex")

from dataclasses import replace

from tools.scenes.cams import EPOCH_NS, FLAWLESS, NINETY_FIVE, cam_log, receiver
from tools.scenes.places import PLACES
from tools.scenes.scene import draw_scene

SPAN = (0.0, 10.0)


@pytest.fixture(scope="module")
def scene():
    return draw_scene(3, "lidar_16", drive="left_turn", vehicles=0, density=0.0)


def messages(scene, flaws=FLAWLESS, place=None, seed=0, span=SPAN):
    width = scene.vehicle.mirror_width_m
    return cam_log(scene.sender, place or scene.place, flaws, span, 7, width, np.random.default_rng(seed))


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.name)
def test_exact_positions_are_the_front_of_the_vehicle(scene, place):
    place = replace(place, yaw_rad=0.7)
    log = messages(scene, place=place)
    times = (log.stamps_ns - EPOCH_NS) / 1e9
    xy, yaw = scene.sender.track(times)
    front = xy + scene.vehicle.length_m / 2 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    to_utm = Transformer.from_crs("EPSG:4326", f"EPSG:{place.epsg}", always_xy=True)
    utm = np.column_stack(to_utm.transform(log.longitude_deg, log.latitude_deg))
    np.testing.assert_allclose(utm, place.to_utm(front), atol=1e-5)


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.name)
def test_the_scenes_metres_are_true_metres_and_headings_true_azimuths(scene, place):
    log = messages(scene, place=place)
    steps = slice(None, None, 10)
    lat, lon = log.latitude_deg[steps], log.longitude_deg[steps]
    azimuth, _, metres = Geod(ellps="WGS84").inv(lon[:-1], lat[:-1], lon[1:], lat[1:])
    times = (log.stamps_ns[steps] - EPOCH_NS) / 1e9
    xy, yaw = scene.sender.track(times)
    front = xy + scene.vehicle.length_m / 2 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    # Around a point the scale of a map changes by 1e-6 in 100 m.
    np.testing.assert_allclose(metres, np.linalg.norm(np.diff(front, axis=0), axis=1), rtol=2e-5, atol=1e-4)
    before = log.heading_deg[steps][:1]
    assert abs((azimuth[0] - before[0] + 180.0) % 360.0 - 180.0) < 2.0


@pytest.mark.parametrize("name", ["rtk", "rtk_float", "dgnss"])
def test_a_receivers_errors_have_the_stated_size_and_memory(scene, name):
    kind = receiver(name)
    span = (0.0, 30.0)
    exact = messages(scene, replace(FLAWLESS, rate_hz=1.0), span=span)
    scale = np.array([111_132.0, 111_320.0 * np.cos(np.radians(scene.place.latitude_deg))])
    errors = []
    for seed in range(300):
        # The phase of sending is drawn first, so a log with the same seed has the same times.
        same = messages(scene, replace(FLAWLESS, rate_hz=1.0), seed=seed, span=span)
        flawed = messages(scene, replace(FLAWLESS, receiver=name, rate_hz=1.0), seed=seed, span=span)
        count = min(len(same), len(exact), 29)
        lat = (flawed.latitude_deg - same.latitude_deg)[:count]
        lon = (flawed.longitude_deg - same.longitude_deg)[:count]
        errors.append(np.column_stack([lat, lon]) * scale)
    error = np.array(errors)
    # 300 x 2 independent processes: their standard deviation is known to 3 %; 4 sigma.
    assert error.std() == pytest.approx(np.hypot(kind.white_m, kind.correlated_m), rel=0.12)
    lagged = (error[:, 0] * error[:, 20]).mean() / kind.correlated_m**2
    assert lagged == pytest.approx(np.exp(-20.0 / kind.correlation_s), abs=0.17)
    assert flawed.semi_major_95_m[0] == pytest.approx(NINETY_FIVE * np.hypot(kind.white_m, kind.correlated_m))
    inside = (np.linalg.norm(error[:, 0], axis=1) < flawed.semi_major_95_m[0]).mean()
    assert inside == pytest.approx(0.95, abs=0.05)


def test_etsi_triggering_sends_when_enough_has_changed(scene):
    log = messages(scene, replace(FLAWLESS, rate_hz=0.0))
    times = (log.stamps_ns - EPOCH_NS) / 1e9
    gaps = np.diff(times)
    assert gaps.min() > 0.099
    assert gaps.max() < 1.01
    xy, yaw = scene.sender.track(times)
    moved = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    turned = np.degrees(np.abs(np.diff(yaw)))
    faster = np.abs(np.diff(scene.sender.drive.speed(times)))
    assert ((moved > 4.0) | (turned > 4.0) | (faster > 0.5) | (gaps > 0.999)).all()
    assert len(log) < 0.9 * len(messages(scene))


def test_fields_have_etsis_steps(scene):
    log = messages(scene, replace(FLAWLESS, quantised=True, rounding="up"))
    for values, step in (
        (log.latitude_deg, 1e-7),
        (log.heading_deg, 0.1),
        (log.speed_mps, 0.01),
        (log.length_m, 0.1),
        (log.width_m, 0.1),
        (log.stamps_ns / 1e9 - EPOCH_NS / 1e9, 1e-3),
    ):
        np.testing.assert_allclose(values / step, np.round(values / step), atol=1e-3)
    assert 0.0 <= log.length_m[0] - scene.vehicle.length_m < 0.1
    assert 0.0 <= log.width_m[0] - scene.vehicle.width_m < 0.1


def test_clock_lever_and_loss_do_what_they_say(scene):
    base = messages(scene)
    late = messages(scene, replace(FLAWLESS, clock_offset_s=0.25))
    np.testing.assert_array_equal(late.stamps_ns - base.stamps_ns, 250_000_000)
    np.testing.assert_array_equal(late.latitude_deg, base.latitude_deg)
    moved = messages(scene, replace(FLAWLESS, lever_m=(0.3, -0.4)))
    metres = Geod(ellps="WGS84").inv(base.longitude_deg, base.latitude_deg, moved.longitude_deg, moved.latitude_deg)[2]
    np.testing.assert_allclose(metres, 0.5, atol=1e-4)
    lossy = messages(scene, replace(FLAWLESS, loss=0.3, rate_hz=100.0))
    # 1000 messages: 4 standard deviations of the binomial.
    assert len(lossy) == pytest.approx(700, abs=58)


def test_a_reversing_vehicle_sends_the_direction_of_motion():
    scene = draw_scene(5, "lidar_16", drive="reverse", min_driven_m=0.0, min_seen=0, density=0.0)
    log = messages(scene)
    times = (log.stamps_ns - EPOCH_NS) / 1e9
    speed = scene.sender.drive.speed(times)
    yaw = scene.sender.track(times)[1]
    body = scene.place.heading_deg(scene.sender.track(times)[0], yaw)
    apart = np.abs((log.heading_deg - body + 180.0) % 360.0 - 180.0)
    assert (speed < -0.5).any()
    assert (apart[speed < -0.5] > 179.0).all()
    assert (apart[speed > 0.5] < 1.0).all()
